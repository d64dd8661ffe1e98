"""Effects of light transport in spectral cubes and in the pictures that captures are made of."""

import sys

import cboxlab
import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.predict.transported import coated, transported
from helpers.scenes.boxes import BANDS, box_with_lamp, camera_inside

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    for name, value in (("_PATCHES_PER_DIAGONAL", 6), ("_PATCH_SAMPLES", 128), ("_AT_ONCE", 61)):
        monkeypatch.setattr(sys.modules["cboxlab.validation.predict.transported"], name, value)


def test_transport_reaches_a_picture_of_all_wavelengths():
    """Fluorescence at 600 nm adds light there, none at 420 nm, and leaves what the picture's error is as it was."""
    scene, camera = cornell_box(), cornell_camera(12)
    image = render_final_gather(RenderJob(scene, camera, WAVELENGTH_NM, 32, 2))
    assert transported(image, scene, camera, (), 1) is image
    effect = apply_checked("fluorescence", {"material": "white", "yield": 0.3, "peak_nm": 600.0}, "test")
    after = transported(image, scene, camera, (effect,), 1)
    weights = np.eye(WAVELENGTH_NM.size)[:, [20, 200]]
    (before_mean, before_variance), (mean, variance) = image.project(weights), after.project(weights)
    white = image.surface == image.surface_names.index("back")
    assert np.all(mean[white, 1] > 1.001 * before_mean[white, 1])
    np.testing.assert_allclose(mean[..., 0], before_mean[..., 0], rtol=1e-5)
    np.testing.assert_allclose(variance, before_variance, rtol=1e-3, atol=1e-20)


def test_a_cube_of_few_wavelengths_changes_as_the_picture_of_all_does():
    """Beyond the visible, too: the room's light goes on above 700 nm, where the published lamp has none."""
    scene, camera, some = cornell_box(), cornell_camera(12), np.array([450.0, 600.0, 740.0])
    effects = [
        apply_checked("ambient-light", {"radiance": 2e-3, "spectrum": "tungsten"}, "test"),
        apply_checked("fluorescence", {"material": "white", "yield": 0.3, "peak_nm": 600.0}, "test"),
    ]
    added = []
    for wavelengths in (WAVELENGTH_NM, some):
        image = render_final_gather(RenderJob(scene, camera, wavelengths, 32, 2))
        before, after = (
            image.cube()["radiance"],
            transported(image, scene, camera, effects, 1).cube()["radiance"],
        )
        added.append((after - before).sel(wavelength=some, method="nearest").values)
    np.testing.assert_allclose(added[1][..., :2], added[0][..., :2], rtol=0.02, atol=1e-4 * added[0].max())
    assert added[1][..., 2].mean() > added[1][..., 1].mean() / 2


def test_a_cube_shows_a_gradient_of_reflectance():
    """Where light is reflected once, the floor is darker by the stated part, linearly from its front to its back."""
    once = apply_checked("interreflection", {"max_bounces": 1}, "test")
    half = apply_checked("reflectance-gradient", {"surface": "floor", "axis": "z", "amplitude": 0.5}, "test")
    plain, graded = (
        cboxlab.render(model, wavelengths=[550.0], size=24, samples=64).cube
        for model in (Model().with_effect(once), Model().with_effect(once).with_effect(half))
    )
    before, after = (cube["radiance"].values[..., 0] for cube in (plain, graded))
    ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
    number = [s.name for s in cornell_box().surfaces].index("floor")
    floor = (plain["surface"].values == number) & (before > 0)
    np.testing.assert_allclose(ratio[:12], 1.0, atol=1e-6)  # the upper half shows no floor
    assert np.all((ratio[floor] > 0.5) & (ratio[floor] < 1.0))
    rows = [ratio[row][floor[row]].mean() for row in range(24) if floor[row].sum() > 6]
    assert np.all(np.diff(rows) > 0)  # lower rows show the floor's front


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_the_specular_part_is_the_coats_lobe_over_the_lamp(rho):
    """Pixel by pixel, against quadrature of Walter's GGX lobe with Fresnel's reflectance over the lamp's square.

    The light leaves the box after one reflection, whatever the base's reflectance, which changes the rest alone.
    """
    scene, camera, strength, alpha = box_with_lamp(rho), camera_inside(16), 0.8, 0.3
    gloss = apply_checked("gloss", {"material": "grey", "specular": strength, "roughness": alpha}, "test")
    image = render_final_gather(RenderJob(scene, camera, BANDS, 64, 2, max_bounces=1))
    parts = coated(image, scene, camera, (gloss,), 1, max_bounces=1)
    floor = (image.surface == image.surface_names.index("floor")) & (image.coverage.max(axis=-1) == 1)
    rows, columns = np.nonzero(floor)
    way = camera.directions(columns, rows)
    point = camera.position_mm - way * (camera.position_mm[1] / way[:, 1])[:, None]
    expected = np.array([_lobe_over_lamp(scene, p, -d, strength, alpha) for p, d in zip(point, way, strict=True)])
    specular = parts.specular[floor]
    assert floor.sum() > 30
    np.testing.assert_allclose(specular, specular[:, :1] * np.ones(3), rtol=1e-6)  # a coat has no colour
    np.testing.assert_allclose(specular[:, 0], expected, rtol=0.1)  # a pixel holds many angles
    assert abs(specular[:, 0].sum() / expected.sum() - 1) < 0.01
    added = parts.image.mean(np.eye(3)) - image.mean(np.eye(3))
    if rho == 0:
        np.testing.assert_allclose(added[floor], specular, rtol=1e-4)
    else:
        assert np.all(added[floor] < specular)  # the coat keeps light from the base


def _lobe_over_lamp(scene, point, outgoing, strength, alpha):
    """Light of a lamp of radiance 1 that a coat on the floor reflects; sums over 40 x 40 parts of the lamp."""
    corners = scene.lamp.surface.vertices_mm
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, z = ((low[k] + (high[k] - low[k]) * (np.arange(40) + 0.5) / 40) for k in (0, 2))
    parts = np.stack([*np.meshgrid(x, z)], axis=-1).reshape(-1, 2)
    to_lamp = np.stack([parts[:, 0], np.full(len(parts), low[1]), parts[:, 1]], axis=1) - point
    square = np.sum(to_lamp**2, axis=1)
    incoming = to_lamp / np.sqrt(square)[:, None]
    half = (incoming + outgoing) / np.linalg.norm(incoming + outgoing, axis=1, keepdims=True)
    density = alpha**2 / (np.pi * (half[:, 1] ** 2 * (alpha**2 - 1) + 1) ** 2)

    def masking(cosine):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))

    c = np.sum(incoming * half, axis=1)
    inside = np.sqrt(1 - (1 - c**2) / 2.25)
    across, along = (c - 1.5 * inside) / (c + 1.5 * inside), (1.5 * c - inside) / (1.5 * c + inside)
    reflected = strength * (across**2 + along**2) / 2
    lobe = reflected * density * masking(incoming[:, 1]) * masking(outgoing[1]) / (4 * incoming[:, 1] * outgoing[1])
    area = (high[0] - low[0]) * (high[2] - low[2]) / len(parts)
    return np.sum(lobe * incoming[:, 1] * incoming[:, 1] * area / square)
