"""Another renderer's cube takes the place of our picture."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files.cube_files import write_cube
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.radiosity.final_gather import gather, render_final_gather, solve_light
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.predict.external_picture import ExternalPicture, external_picture, require_level
from scipy.interpolate import interp1d

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SCENE, CAMERA = cornell_box(), cornell_camera(16)


@pytest.fixture(scope="module")
def light():
    return solve_light(SCENE, WAVELENGTH_NM, patch_edge_mm=120.0, patch_samples=64)


@pytest.fixture(scope="module")
def image():
    return render_final_gather(RenderJob(SCENE, CAMERA, WAVELENGTH_NM[::10], 16, 8))


@pytest.mark.parametrize("ending", ["nc", "exr"])
def test_a_cube_of_ours_read_as_another_renderers_is_the_same_picture(tmp_path, light, image, ending):
    path = tmp_path / f"cube.{ending}"
    write_cube(path, image.cube())
    other = external_picture(path, SCENE, CAMERA, light).image
    weights = np.eye(WAVELENGTH_NM.size)[:, ::10]
    mean, variance = other.project(weights)
    expected, error = image.project(np.eye(image.wavelength_nm.size))
    np.testing.assert_allclose(mean, expected, rtol=2e-3, atol=1e-9)
    if ending == "nc":
        # a pixel's variance is pooled with those of its neighbours, and widened for few batches
        assert 0.7 < variance.sum() / error.sum() < 2
    np.testing.assert_array_equal(other.surface, image.surface)


def test_between_wavelengths_ratios_to_our_spectrum_are_linear(tmp_path, light):
    """A cube of ours at 20 nm: linear spectra are off by over 1 % of their maximum, ratios pixel by pixel hardly."""
    ours = gather(light, CAMERA, 256, 2)
    walls = ours.surface >= 0
    total = ours.project(np.eye(WAVELENGTH_NM.size))[0][walls]
    coarse = replace(ours, spectra=ours.spectra[:, ::20], wavelength_nm=WAVELENGTH_NM[::20])
    write_cube(tmp_path / "cube.nc", coarse.cube())
    image_px = external_picture(tmp_path / "cube.nc", SCENE, CAMERA, light).image.project(np.eye(WAVELENGTH_NM.size))[0]
    linear = interp1d(WAVELENGTH_NM[::20], total[:, ::20])(WAVELENGTH_NM)
    plain, by_ratio = ((spectrum - total) / total.max(axis=1, keepdims=True) for spectrum in (linear, image_px[walls]))
    assert np.sqrt(np.mean(by_ratio**2)) < 0.1 * np.sqrt(np.mean(plain**2))


def test_another_renderers_picture_moves_as_ours_does(tmp_path):
    """One of ours in the place of another's, with the same random numbers, becomes our own from the other camera."""
    light = solve_light(SCENE, WAVELENGTH_NM[::10], patch_edge_mm=120.0, patch_samples=64)
    moved = CAMERA.with_parameters(CAMERA.parameters + 0.3 * np.eye(10)[7])
    ours = gather(light, CAMERA, 256, 4, seed=5)
    picture = ExternalPicture(ours, CAMERA, light, tmp_path)
    assert picture.through(CAMERA, 5) is ours
    through_picture, expected = picture.through(moved, 5), gather(light, moved, 256, 4, seed=5)
    weights = np.eye(light.wavelength_nm.size)
    for value, expected_value in zip(through_picture.project(weights), expected.project(weights), strict=True):
        np.testing.assert_allclose(value, expected_value, rtol=1e-3, atol=1e-5 * np.max(expected_value))
    np.testing.assert_array_equal(through_picture.coverage, expected.coverage)
    assert np.any(through_picture.surface != ours.surface)


def test_a_picture_under_another_lamp_is_refused(tmp_path):
    require_level(tmp_path / "cube.nc", 1.3)
    with pytest.raises(InputError, match="100 times as bright"):
        require_level(tmp_path / "cube.nc", 0.01)


def test_a_cube_that_does_not_fit_is_refused(tmp_path, light, image):
    path = tmp_path / "cube.nc"
    write_cube(path, image.cube())
    with pytest.raises(InputError, match="16 x 16 px"):
        external_picture(path, SCENE, cornell_camera(24), light)
    write_cube(path, replace(image, wavelength_nm=image.wavelength_nm + 50.0).cube())
    with pytest.raises(InputError, match="450 to 750 nm"):
        external_picture(path, SCENE, CAMERA, light)


def test_a_cube_without_standard_errors_has_those_of_its_neighbours_scatter(tmp_path, light):
    """Noise of 3 % added to a picture of little noise, and not stated: estimated within a tenth inside walls."""
    camera = cornell_camera(64)
    clean = render_final_gather(RenderJob(SCENE, camera, WAVELENGTH_NM[::100], 256, 2)).cube()
    noise = 0.03 * np.random.default_rng(4).standard_normal(clean["radiance"].shape)
    cube = clean.drop_vars("standard_error")
    cube["radiance"] = (clean["radiance"] * (1 + noise)).assign_attrs(clean["radiance"].attrs)
    write_cube(tmp_path / "cube.nc", cube)
    picture = external_picture(tmp_path / "cube.nc", SCENE, camera, light)
    assert picture.estimated
    image = picture.image
    inside = image.single_surface & (image.surface >= 0)
    mean, variance = (values[inside][:, 1:] for values in image.project(np.eye(WAVELENGTH_NM.size)[:, ::100]))
    assert np.median(np.sqrt(variance) / mean) == pytest.approx(0.03, rel=0.1)
