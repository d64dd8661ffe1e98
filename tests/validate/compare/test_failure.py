"""Where the model fails: light split by its reflections, and groups of residuals found where they were put."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.light_shares import LightShares, light_shares
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare.failure import parts, ranked_failures
from cboxlab.validation.report.table_sections import parts_section
from helpers.scenes.boxes import BANDS
from scipy.ndimage import binary_dilation

NAMES = ("floor", "left", "right")
PAINTS = {"floor": "white", "left": "red", "right": "white"}
NM = (400.0, 500.0, 600.0)


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")
def test_shares_are_those_of_renders_that_stop_early():
    """Direct light is the picture after one reflection, what came by way of paints that after two; all sum to 1."""
    scene, camera = cornell_box(), cornell_camera(24)
    image = render_final_gather(RenderJob(scene, camera, BANDS, 512, 2, seed=1))
    shares = light_shares(image, scene, np.eye(3))
    total = np.moveaxis(image.project(np.eye(3))[0], -1, 0)
    used = image.single_surface & (image.surface >= 0) & ~binary_dilation(image.sees_lamp, np.ones((3, 3)))
    np.testing.assert_allclose((shares.direct + shares.via_material.sum(axis=0) + shares.many)[:, used], 1.0)
    for bounces, share in ((1, shares.direct), (2, shares.direct + shares.via_material.sum(axis=0))):
        other = render_path_tracer(RenderJob(scene, camera, BANDS, 256, 4, seed=9, max_bounces=bounces))
        mean, variance = other.project(np.eye(3))
        for band in range(3):
            mean_signal = (share * total)[band][used].mean()
            error = np.sqrt(variance[..., band][used].sum()) / used.sum()
            assert mean_signal == pytest.approx(mean[..., band][used].mean(), abs=5 * error + 2e-4 * mean_signal)
    with pytest.raises(ValueError, match="final gather"):
        light_shares(render_path_tracer(RenderJob(scene, camera, BANDS[:2], 4, 1)), scene, np.eye(2))


def comparison(z, p_value=0.0):
    """A picture of three upright strips, 20 px wide each."""
    surface = np.repeat(np.arange(3), 20)[None].repeat(40, axis=0)
    distance = np.minimum(np.arange(60) % 20, 19 - np.arange(60) % 20)[None].repeat(40, axis=0) + 0.0
    maps = xr.Dataset(
        {
            "residual_over_sigma": (("band", "y", "x"), z),
            "surface": (("y", "x"), surface),
            "edge_distance_px": (("y", "x"), distance),
        }
    )
    chi2 = SimpleNamespace(p_value=p_value)
    bands = tuple(f"f{nm:.0f}" for nm in NM)
    return SimpleNamespace(maps=maps, bands=bands, by_surface=dict.fromkeys(NAMES), chi2=chi2)


def noise():
    return np.random.default_rng(0).standard_normal((3, 40, 60))


def split(direct):
    shape = (3, 40, 60)
    first = np.full(shape, 0.9)
    first[:, direct == 0] = 0.1
    return LightShares(first, np.zeros((2, *shape)), 1 - first)


def test_an_excess_is_found_where_it_was_put():
    """Twice the noise inside the left wall where light is indirect, in the first band: in these words."""
    z = noise()
    direct = np.ones((40, 60))
    direct[:20, :] = 0
    where = np.zeros_like(z, bool)
    where[0, :20, 23:37] = True
    z[where] *= 4
    c = comparison(z)
    picture_parts = parts(c, PAINTS, NM, split(direct))
    failures = ranked_failures(c, picture_parts)
    assert failures[0].label == "in interiors on the left wall where light is indirect in band f400"
    assert failures[0].share_of_excess == pytest.approx(1.0, abs=0.05)
    assert failures[0].share_of_residuals == pytest.approx(where.mean(), rel=0.01)
    assert failures[0].chi2_per_residual == pytest.approx(np.mean(z[where] ** 2))
    (table,) = parts_section(c, picture_parts).blocks
    (indirect,) = [row for row in table.rows if row[0] == "where light is indirect"]
    assert float(indirect[2]) == pytest.approx(100, abs=5)


def test_two_places_are_two_entries_and_noise_is_none():
    """The larger mean chi-square comes first, though the other place has three times the residuals."""
    z = noise()
    z[:, :, :20] *= 3
    z[2, :, 40:] *= 3.3
    c = comparison(z)
    picture_parts = parts(c, PAINTS, NM, None)
    second, first = ranked_failures(c, picture_parts)[:2]
    assert first.kinds == {"surface": "on the floor"} and second.chi2_per_residual > first.chi2_per_residual
    assert set(second.kinds) == {"surface", "band"} and "right" in second.label and "f600" in second.label
    assert ranked_failures(comparison(noise(), p_value=0.4), picture_parts) == ()


def test_surfaces_of_one_paint_are_named_together():
    z = noise()
    z[:, :, :20] *= 3
    z[:, :, 40:] *= 3
    c = comparison(z)
    assert ranked_failures(c, parts(c, PAINTS, NM, None))[0].label == "on white surfaces"
