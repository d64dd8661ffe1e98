"""Pictures are found again by content and near cameras only; another renderer's cube takes a picture's place."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM
from cboxlab.render.cube_files import write_cube
from cboxlab.render.final_gather import gather, render_final_gather, solve_light
from cboxlab.render.variant import compiled
from cboxlab.scenes import InputError, cornell_box, cornell_camera
from cboxlab.validate.effects import apply_checked
from cboxlab.validate.foreign import ForeignPicture, foreign_picture, require_level
from cboxlab.validate.picture_cache import cached_picture, content_key

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SCENE, CAMERA = cornell_box(), cornell_camera(16)
CORNERS = np.concatenate([s.vertices_mm for s in SCENE.surfaces])


@pytest.fixture(scope="module")
def image():
    return render_final_gather(SCENE, CAMERA, WAVELENGTH_NM[::10], 16, 2)


def test_a_picture_comes_back_for_a_near_camera_only(tmp_path, image):
    made = []

    def make():
        made.append(1)
        return image

    near = CAMERA.with_parameters(CAMERA.parameters + 1e-4 * np.eye(10)[7])
    far = CAMERA.with_parameters(CAMERA.parameters + 0.2 * np.eye(10)[7])
    key = content_key(SCENE, 0.3, None)
    for camera, renders in ((CAMERA, 1), (near, 1), (far, 2), (CAMERA, 2)):
        found, through = cached_picture(tmp_path, key, camera, CORNERS, make)
        assert len(made) == renders
        np.testing.assert_array_equal(found.coefficients, image.coefficients)
        np.testing.assert_array_equal(found.spectra, image.spectra)
        assert found.surface_names == image.surface_names
    np.testing.assert_array_equal(through.parameters, CAMERA.parameters)
    for path in tmp_path.iterdir():
        path.write_bytes(b"broken")
    cached_picture(tmp_path, key, CAMERA, CORNERS, make)
    assert len(made) == 3
    cached_picture(None, key, CAMERA, CORNERS, make)
    assert len(made) == 4


def test_the_key_is_the_content():
    """Another paint, lamp, place or setting is another key; the same content the same."""
    keys = [content_key(SCENE, 0.3, None), content_key(SCENE, 0.2, None), content_key(SCENE, 0.3, 1)]
    for effect, values in (
        ("wall-reflectance", {"material": "red", "scale": 1.01}), ("lamp-power", {"scale": 1.01}),
        ("lamp-directional", {"exponent": 0.1}), ("block-pose", {"block": "tall", "dx_mm": 0.1}),
    ):  # fmt: skip
        keys.append(content_key(apply_checked(effect, values, "test").apply(SCENE), 0.3, None))
    patterned = replace(SCENE, lamp=replace(SCENE.lamp, pattern=np.array([[0.5, 1.5]])))
    keys.append(content_key(patterned, 0.3, None))
    assert len(set(keys)) == len(keys)
    assert content_key(cornell_box(), 0.3, None) == keys[0]


@pytest.mark.parametrize("ending", ["nc", "exr"])
def test_a_cube_of_ours_read_as_another_renderers_is_the_same_picture(tmp_path, image, ending):
    path = tmp_path / f"cube.{ending}"
    write_cube(path, image.cube())
    other = foreign_picture(path, SCENE, CAMERA)
    weights = np.eye(WAVELENGTH_NM.size)[:, ::10]
    mean, variance = other.project(weights)
    expected, error = image.project(np.eye(image.wavelength_nm.size))
    np.testing.assert_allclose(mean, expected, rtol=2e-3, atol=1e-9)
    if ending == "nc":
        np.testing.assert_allclose(variance, error, rtol=1e-2, atol=1e-12)
    np.testing.assert_array_equal(other.surface, image.surface)


def test_another_renderers_picture_moves_as_ours_does():
    """One of ours in the place of another's, with the same random numbers, becomes our own from the other camera."""
    light = solve_light(SCENE, WAVELENGTH_NM[::10], patch_edge_mm=120.0, patch_samples=64)
    moved = CAMERA.with_parameters(CAMERA.parameters + 0.3 * np.eye(10)[7])
    ours = gather(light, CAMERA, 256, 4, seed=5)
    shown = ForeignPicture(ours, CAMERA, light)
    assert shown.through(CAMERA, 5) is ours
    found, expected = shown.through(moved, 5), gather(light, moved, 256, 4, seed=5)
    weights = np.eye(light.wavelength_nm.size)
    for value, wanted in zip(found.project(weights), expected.project(weights), strict=True):
        np.testing.assert_allclose(value, wanted, rtol=1e-3, atol=1e-5 * np.max(wanted))
    np.testing.assert_array_equal(found.coverage, expected.coverage)
    assert np.any(found.surface != ours.surface)


def test_a_picture_under_another_lamp_is_refused(tmp_path):
    require_level(tmp_path / "cube.nc", 1.3)
    with pytest.raises(InputError, match="100 times as bright"):
        require_level(tmp_path / "cube.nc", 0.01)


def test_a_cube_that_does_not_fit_is_refused(tmp_path, image):
    path = tmp_path / "cube.nc"
    write_cube(path, image.cube())
    with pytest.raises(InputError, match="16 x 16 px"):
        foreign_picture(path, SCENE, cornell_camera(24))
    write_cube(path, replace(image, wavelength_nm=image.wavelength_nm + 50.0).cube())
    with pytest.raises(InputError, match="450 to 750 nm"):
        foreign_picture(path, SCENE, CAMERA)
