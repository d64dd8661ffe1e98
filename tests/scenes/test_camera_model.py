"""The camera's geometry: conventions, distortion and its inverse, agreement with OpenCV."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from cboxlab.scenes import Camera, cornell_camera
from cboxlab.scenes.camera import PARAMETER_NAMES, REFERENCE_ROTATION
from helpers.places import ROOT
from hypothesis import given
from hypothesis import strategies as st

turned = st.lists(st.floats(-20, 20), min_size=3, max_size=3)
distortions = st.floats(-0.3, 0.3)


def camera_with(turn_deg=(0.0, 0.0, 0.0), k1=0.0):
    values = [278.0, 273.0, -800.0, *turn_deg, 358.4, 120.3, 131.9, k1]
    return cornell_camera(256).with_parameters(values)


def test_published_camera_sees_39_31_degrees_from_edge_to_edge():
    """2 atan(12.5 / 35); the image's edges lie half a pixel outside the outermost pixel centres."""
    camera = cornell_camera(256)
    left, right = camera.directions([-0.5, 255.5], 127.5)
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(39.31, abs=0.005)
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(2 * np.degrees(np.arctan(12.5 / 35)))


def test_plus_x_is_to_the_left_and_plus_y_is_up():
    """The red wall at x = 550 must appear on the left; a mirrored image would swap it with the green one."""
    camera = cornell_camera(256)
    red, green, top, floor = camera.project([[550, 273, 0], [0, 273, 0], [278, 548, 0], [278, 0, 0]])
    assert red[0] < 127.5 < green[0]
    assert top[1] < 127.5 < floor[1]


def test_zero_zero_is_the_centre_of_the_top_left_pixel():
    """The optical axis of a centred camera of even size meets the corner that four pixels share."""
    camera = cornell_camera(4)
    assert camera.project([[278, 273, 100]])[0] == pytest.approx([1.5, 1.5])
    u, v = np.meshgrid(np.arange(4), np.arange(4))
    directions = camera.directions(u, v)
    assert directions.shape == (4, 4, 3)
    assert directions.sum(axis=(0, 1))[:2] == pytest.approx([0, 0], abs=1e-12)


@given(turned, distortions, st.floats(-0.5, 255.5), st.floats(-0.5, 255.5), st.floats(1.0, 5000.0))
def test_a_point_on_the_ray_through_a_pixel_appears_at_that_pixel(turn_deg, k1, u, v, distance_mm):
    camera = camera_with(turn_deg, k1)
    direction = camera.directions(u, v)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert camera.project([camera.position_mm + distance_mm * direction])[0] == pytest.approx([u, v], abs=1e-7)


@given(turned, distortions)
def test_opencv_projects_to_the_same_place(turn_deg, k1):
    camera = camera_with(turn_deg, k1)
    points = np.random.default_rng(1).uniform([0, 0, 0], [556, 549, 559], (50, 3))
    matrix = np.array([[358.4, 0, 120.3], [0, 358.4, 131.9], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(camera.rotation)
    # near half a turn, where these cameras are, OpenCV's vector has lost digits: compare at what it says
    camera = replace(camera, rotation=cv2.Rodrigues(turn)[0])
    assert np.abs(camera.rotation - camera_with(turn_deg).rotation).max() < 0.01
    shift = -camera.rotation @ camera.position_mm
    expected, _ = cv2.projectPoints(points, turn, shift, matrix, np.array([k1, 0.0, 0.0, 0.0]))
    assert np.allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


def decentred(camera, p1):
    """With OpenCV's first tangential term, which the ten parameters lack."""

    def shift(image_px):
        x, y = ((image_px - camera.principal_point_px) / camera.focal_length_px).T
        return camera.focal_length_px * p1 * np.stack([2 * x * y, x**2 + 3 * y**2], axis=-1)

    return camera.distorted_further(shift)


def test_further_distortion_is_where_opencv_has_its_tangential_terms():
    """Both are functions of the undistorted place, so two of them in a row add up."""
    points = np.random.default_rng(1).uniform([0, 0, 0], [556, 549, 559], (50, 3))
    camera = decentred(decentred(camera_with(), 0.01), 0.005)
    matrix = np.array([[358.4, 0, 120.3], [0, 358.4, 131.9], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(camera.rotation)
    camera = replace(camera, rotation=cv2.Rodrigues(turn)[0])
    shift = -camera.rotation @ camera.position_mm
    expected, _ = cv2.projectPoints(points, turn, shift, matrix, np.array([0.0, 0.0, 0.015, 0.0]))
    assert np.allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)
    assert np.abs(camera.project(points) - camera_with().project(points)).max() > 0.5


@given(turned, distortions, st.floats(-0.5, 255.5), st.floats(-0.5, 255.5), st.floats(-0.02, 0.02))
def test_a_ray_through_a_pixel_knows_of_further_distortion(turn_deg, k1, u, v, p1):
    camera = decentred(camera_with(turn_deg, k1), p1)
    point = camera.position_mm + 900.0 * camera.directions(u, v)
    assert camera.project([point])[0] == pytest.approx([u, v], abs=1e-5)


def test_the_closest_parameters_leave_the_least_to_further_distortion():
    """Tangential distortion, f p1 (2xy, x^2 + 3y^2), is a turn by 2 p1 sideways and by 3 p1 downwards: a turn between
    the two leaves less than half of it, of the same camera. A turn written as further distortion is found whole."""
    points = np.random.default_rng(1).uniform([0, 0, 0], [556, 549, 559], (200, 3))
    camera = decentred(camera_with(k1=-0.05), 0.01)
    closest = camera.closest_parameters()
    assert np.allclose(closest.project(points), camera.project(points), atol=1e-6)
    image = camera_with().project(points)
    before, after = (np.sqrt(np.mean(c.further_distortion(image) ** 2)) for c in (camera, closest))
    assert after < 0.5 * before
    assert 0.02 < np.radians(abs(closest.parameters[3] - camera.parameters[3])) < 0.03

    straight, away = camera_with(), camera_with((0.3, -0.2, 0.1), 0.01)
    written = straight.distorted_further(
        lambda image_px: away.project(straight.position_mm + straight.directions(*image_px.T)) - image_px
    )
    assert np.allclose(written.closest_parameters().parameters, away.parameters, atol=1e-6)
    assert np.abs(written.closest_parameters().further_distortion(image)).max() < 1e-6
    assert straight.closest_parameters() is straight


@given(turned, distortions)
def test_parameters_describe_the_camera_completely(turn_deg, k1):
    camera = camera_with(turn_deg, k1)
    assert len(camera.parameters) == len(PARAMETER_NAMES)
    assert camera.parameters[3:6] == pytest.approx(turn_deg, abs=1e-9)
    again = cornell_camera(256).with_parameters(camera.parameters)
    assert np.allclose(again.rotation, camera.rotation, atol=1e-12)
    assert again.rotation @ again.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(again.rotation) == pytest.approx(1.0)


def test_rodrigues_vector_turns_the_camera_in_its_own_axes():
    """R = Rod(r) R0: r about the camera's y axis (down) by +5 degrees moves a point ahead by f tan(5 deg)."""
    camera = camera_with((0.0, 5.0, 0.0))
    u, v = camera.project([[278.0, 273.0, 100.0]])[0]
    assert (u, v) == pytest.approx((120.3 + 358.4 * np.tan(np.radians(5)), 131.9))
    assert camera_with().rotation == pytest.approx(REFERENCE_ROTATION)


def test_points_behind_the_camera_appear_nowhere():
    assert np.isnan(cornell_camera(256).project([[278.0, 273.0, -900.0], [300.0, 273.0, -800.0]])).all()


def test_motion_is_rms_per_coordinate_of_what_both_cameras_see():
    """One point moves by (3, 1) px, by the principal point; another one stands behind both cameras."""
    camera = cornell_camera(256)
    moved = replace(camera, principal_point_px=camera.principal_point_px + np.array([3.0, 1.0]))
    points = [[278.0, 273.0, 100.0], [278.0, 273.0, -900.0]]
    assert camera.motion_px(moved, points) == pytest.approx(np.sqrt((9 + 1) / 2))


def test_no_ray_arrives_beyond_the_fold_of_a_barrel_distortion():
    """r (1 + k1 r^2) is largest at r^2 = -1 / (3 k1), where it is 2 r / 3."""
    camera = Camera(256, 256, 100.0, np.array([127.5, 127.5]), -0.3, REFERENCE_ROTATION, np.zeros(3))
    largest = 100.0 * 2 / 3 * np.sqrt(1 / 0.9)
    inner, outer = camera.directions(127.5 + np.array([0.999, 1.001]) * largest, 127.5)
    assert np.isfinite(inner).all() and np.isnan(outer).all()


def test_the_example_on_the_page_of_conventions_runs():
    page = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert "assert" in example
    exec(compile(example, "conventions.md", "exec"), {})
