"""Photographs behind a mosaic against their scene: gaps filled, dark channels left out, each mistake once."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.calibration.instrument import Mask
from cboxlab.calibration.quality import Suspicion
from cboxlab.validation.capture_checks.find import _each_mistake_once
from cboxlab.validation.capture_checks.materials import _Colours, _exchanged_bands
from cboxlab.validation.capture_checks.scene_view import _is_noise, without_gaps

CHANNELS = ("R", "G", "B")


def capture(filters):
    """Bands of filters behind the three channels of one frame each."""
    bands = [SimpleNamespace(id=f"{f}-{c}", channel=c, frames=(f"{f}.tif",)) for f in filters for c in CHANNELS]
    return SimpleNamespace(manifest=SimpleNamespace(band=bands), band_ids=[band.id for band in bands])


def images(signal, variance, mask):
    data = {"signal": signal, "variance": variance, "mask": mask}
    return SimpleNamespace(images=xr.Dataset({name: (("band", "y", "x"), value) for name, value in data.items()}))


def test_gaps_are_filled_and_saturated_pixels_are_not():
    v, u = np.indices((12, 12)).astype(float)
    light, mask = 100 + 3 * u + 2 * v, np.full((1, 12, 12), Mask.OTHER_CHANNEL, np.uint8)
    mask[0, ::2, ::2] = 0
    mask[0, 3:6, 3:6] |= np.uint8(Mask.SATURATED)
    filled = without_gaps(images(np.where(mask == 0, light, 999.0), np.ones((1, 12, 12)), mask), (2, 2))[0]
    assert np.isnan(filled[3:6, 3:6]).all()
    inside = np.isfinite(filled[:11, :11])
    inside[2:7, 2:7] = False
    np.testing.assert_allclose(filled[:11, :11][inside], light[:11, :11][inside], rtol=1e-9)


def test_a_channel_that_sees_nothing_is_noise():
    noise = np.random.default_rng(1).standard_normal((3, 16, 16))
    signal = noise + np.array([0.2, 5.0, -0.5])[:, None, None]
    bands = images(signal, np.ones((3, 16, 16)), np.zeros((3, 16, 16), np.uint8))
    assert _is_noise(bands).tolist() == [True, False, True]


def test_frames_are_exchanged_with_all_their_channels():
    """Two paints under three filters; one channel of the first sees nothing."""
    colours = np.random.default_rng(2).normal(0, 0.5, (2, 9))
    columns = [0, 1, *range(3, 9)]
    swapped = colours[:, [6, 7, 8, 3, 4, 5, 0, 1, 2]]
    seen_as = _Colours(swapped[:, columns], colours[:, columns], ["red", "green"], columns)
    misfit = float(np.mean((swapped - colours) ** 2))
    suspicion = _exchanged_bands(capture(("a", "b", "c")), seen_as, misfit)
    assert suspicion.what == "the frames of a-R, a-G and c-R, c-G, c-B are exchanged"
    sound = _Colours(colours[:, columns] + 0.1, colours[:, columns], ["red", "green"], columns)
    assert _exchanged_bands(capture(("a", "b", "c")), sound, 0.01) is None


@pytest.mark.parametrize(
    ("of_calibration", "of_scene", "expected"),
    [
        ([], ["band[0] (a-R)", "band[1] (a-G)", "band[3] (b-R)"], ["band[0] (a-R)", "band[3] (b-R)"]),
        (
            ["band[4] (b-G).exposure_s"],
            ["band[3] (b-R)", "band[0] (a-R)"],
            ["band[4] (b-G).exposure_s", "band[0] (a-R)"],
        ),
        (
            ["band[0] (a-R).frames", "camera.gain_e_per_dn"],
            ["band[0] (a-R).frames, band[3] (b-R).frames", "band[4] (b-G)"],
            ["camera.gain_e_per_dn", "band[0] (a-R).frames, band[3] (b-R).frames"],
        ),
        (["points.csv: x_mm, y_mm, z_mm"], ["lamp.radiance", "band[0] (a-R)"], ["points.csv: x_mm, y_mm, z_mm"]),
        (["points.csv: p03"], ["lamp.radiance"], 2),
        (["band[3] (b-R).frames"], ["band[3] (b-R).frames and later ones"], 2),
    ],
)
def test_a_mistake_that_explains_others_stands_alone(of_calibration, of_scene, expected):
    first, second = (tuple(Suspicion("what", where, "why") for where in group) for group in (of_calibration, of_scene))
    where = [suspicion.where for suspicion in _each_mistake_once(capture(("a", "b")), first, second)]
    assert where == (expected if isinstance(expected, list) else [*of_calibration, *of_scene])
