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
from cboxlab.validation.predict.transported import transported

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
