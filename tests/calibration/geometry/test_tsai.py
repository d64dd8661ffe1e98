"""Tsai's parameters: his own model, the sense of his distortion, and the way there and back."""

import numpy as np
import pytest
from cboxlab.calibration.geometry.tsai import TsaiCamera, from_tsai, to_tsai
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.utils.errors import InputError
from scipy.spatial.transform import Rotation

TURN = Rotation.from_rotvec([3.0, -8.0, 5.0], degrees=True).as_matrix() @ REFERENCE_ROTATION
PITCH_MM = 0.09765625


def camera_with(k1: float) -> Camera:
    return Camera(256, 256, 357.0, np.array([125.6, 128.2]), k1, TURN, np.array([278.0, 273.0, -800.0]))


def tsai_with(kappa1: float, scale: float = 1.0) -> TsaiCamera:
    return TsaiCamera(
        256,
        256,
        35.0,
        np.array([125.6, 128.2]),
        scale,
        kappa1,
        TURN,
        np.array([10.0, 20.0, 900.0]),
        np.full(2, PITCH_MM),
    )


def box_points() -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 550, (200, 3))


def test_tsai_projects_what_he_undoes() -> None:
    """The defining equation holds at the projected position: X_u = X_d (1 + kappa1 r_d^2) = f x / z."""
    for kappa1 in (-3e-4, 0.0, 2e-4, 1e-3):
        tsai = tsai_with(kappa1, scale=1.03)
        points = tsai.rotation.T @ (np.array([[0.3], [-0.2], [1.0]]) * 900 - tsai.translation_mm[:, None])
        image = tsai.project(points.T)
        np.testing.assert_allclose(tsai.undistorted_mm(image), [[35 * 0.3, -35 * 0.2]], rtol=1e-9)
    # One horizontal mm is s_x / d_x pixels (Tsai's equation 7a).
    no_distortion = tsai_with(0.0, scale=1.03).project(points.T)[0] - [125.6, 128.2]
    np.testing.assert_allclose(no_distortion, [1.03 * 35 * 0.3 / PITCH_MM, -35 * 0.2 / PITCH_MM])


def test_a_radius_that_no_sensor_position_shows_is_nan() -> None:
    """With kappa1 < 0 the undistorted radius has a largest value, (2 / 3) / sqrt(-3 kappa1)."""
    tsai = tsai_with(-1e-3)
    largest = 2 / 3 / np.sqrt(3e-3) / 35.0
    rays = np.array([[0.99 * largest, 0, 1], [1.01 * largest, 0, 1], [0, 0, -1.0]])
    image = tsai.project((rays * 900 - tsai.translation_mm) @ tsai.rotation)
    assert np.isfinite(image[0]).all() and np.isnan(image[1:]).all()


def test_without_distortion_the_conversion_is_exact() -> None:
    camera = camera_with(0.0)
    converted = to_tsai(camera, PITCH_MM)
    assert converted.largest_px < 1e-9 and abs(converted.camera.kappa1_per_mm2) < 1e-12
    assert converted.camera.focal_length_mm == pytest.approx(357.0 * PITCH_MM)
    np.testing.assert_allclose(converted.camera.project(box_points()), camera.project(box_points()), atol=1e-9)
    back = from_tsai(converted.camera)
    np.testing.assert_allclose(back.camera.parameters, camera.parameters, atol=1e-9)


@pytest.mark.parametrize("k1", [-0.2, -0.05, 0.012, 0.05])
def test_the_stated_residual_is_that_of_the_projected_box(k1: float) -> None:
    """To first order kappa1 f^2 = -k1; what is left is at most 3 k1^2 r^5 f, and is stated."""
    camera = camera_with(k1)
    converted = to_tsai(camera, PITCH_MM)
    tsai = converted.camera
    assert tsai.kappa1_per_mm2 * tsai.focal_length_mm**2 == pytest.approx(-k1, rel=5 * abs(k1) + 0.01)
    corner = 0.5 * np.hypot(256, 256) / 357.0
    assert converted.rms_px < converted.largest_px < 3 * k1**2 * corner**5 * 357.0
    image = camera.project(box_points())
    inside = np.all((image > 0) & (image < 255), axis=1)
    difference = np.linalg.norm(tsai.project(box_points()[inside]) - image[inside], axis=1)
    assert inside.sum() > 50 and difference.max() < 1.01 * converted.largest_px
    back = from_tsai(tsai)
    again = np.linalg.norm(back.camera.project(box_points()[inside]) - image[inside], axis=1)
    assert again.max() < 1.01 * (converted.largest_px + back.largest_px)


def test_a_pixel_that_is_not_square_is_stated_as_a_difference() -> None:
    """s_x = 1.02: the best square pixel lies between, 1% off each way; 1% of 128 px at the edges."""
    conversion = from_tsai(tsai_with(1e-5, scale=1.02))
    assert 1.0 < conversion.largest_px < 2.5


def test_what_is_no_camera_is_refused() -> None:
    tsai = tsai_with(0.0, scale=0.0)
    with pytest.raises(InputError, match="s_x"):
        from_tsai(tsai)
    mirrored = TsaiCamera(**{**vars(tsai_with(0.0)), "rotation": np.diag([1.0, 1.0, -1.0])})
    with pytest.raises(InputError, match="Tsai camera: R"):
        from_tsai(mirrored)
    with pytest.raises(InputError, match="pitch"):
        to_tsai(camera_with(0.0), 0.0)
