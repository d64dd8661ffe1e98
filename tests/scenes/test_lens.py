"""Lenses of more terms against OpenCV's own projection, their inverse, and what a camera keeps of them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.lens import Lens

LENSES = {
    "k2": (-0.2, Lens(k2=0.3)),
    "k3": (-0.2, Lens(k2=0.3, k3=-0.4)),
    "decentred": (-0.2, Lens(k2=0.3, p1=0.01, p2=-0.015)),
    "oblong pixels": (0.1, Lens(aspect=1.04)),
    "all terms": (-0.2, Lens(k2=0.4, k3=-0.3, p1=0.01, p2=-0.008, aspect=0.97)),
    "fisheye": (0.0, Lens("fisheye")),
    "fisheye of four terms": (-0.04, Lens("fisheye", k2=0.02, k3=-0.01, k4=0.003, aspect=1.02)),
}


def camera(name, wide=1.0):
    k1, lens = LENSES[name]
    turned = cornell_camera(256).with_parameters([270.0, 280.0, -760.0, 1.0, -2.0, 3.0, 350.0 / wide, 121.3, 131.9, k1])
    return replace(turned, lens=lens)


def points():
    return np.random.default_rng(2).uniform([0, 0, 0], [556, 549, 559], (60, 3))


@pytest.mark.parametrize("name", LENSES)
def test_points_appear_where_opencv_puts_them(name):
    lens_camera = camera(name)
    lens, turn = lens_camera.lens, cv2.Rodrigues(lens_camera.rotation)[0]
    # near half a turn OpenCV's vector has lost digits, so both use the rotation that it describes
    lens_camera = replace(lens_camera, rotation=cv2.Rodrigues(turn)[0])
    shift = -lens_camera.rotation @ lens_camera.position_mm
    matrix = np.diag([*lens_camera.scales_px, 1.0])
    matrix[:2, 2] = lens_camera.principal_point_px
    if lens.model == "fisheye":
        terms = np.array([lens_camera.k1, lens.k2, lens.k3, lens.k4])
        expected, _ = cv2.fisheye.projectPoints(points()[:, None], turn, shift, matrix, terms)
    else:
        terms = np.array([lens_camera.k1, lens.k2, lens.p1, lens.p2, lens.k3])
        expected, _ = cv2.projectPoints(points(), turn, shift, matrix, terms)
    assert np.allclose(lens_camera.project(points()), expected.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("name", LENSES)
def test_a_ray_through_a_pixel_comes_back_to_it(name):
    lens_camera = camera(name)
    u, v = np.meshgrid(np.linspace(-0.5, 255.5, 33), np.linspace(-0.5, 255.5, 33))
    back = lens_camera.project((lens_camera.position_mm + 900.0 * lens_camera.directions(u, v)).reshape(-1, 3))
    assert np.abs(back - np.stack([u, v], axis=-1).reshape(-1, 2)).max() < 1e-9


def test_a_ray_comes_back_through_a_lens_far_out_of_centre():
    """Ten times the decentring of lenses on sale: Newton's steps arrive with the right derivatives only."""
    slopes = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.5, 0.5, 11)), axis=-1).reshape(-1, 2)
    lens = Lens("polynomial", p1=0.06, p2=-0.06, k2=0.1)
    np.testing.assert_allclose(lens.undistorted(lens.distorted(slopes, -0.2), -0.2), slopes, atol=1e-10)


def test_a_fisheye_sees_to_the_side_and_not_behind():
    """Without coefficients the radius is f times the angle: no ray beyond a quarter turn."""
    lens_camera = camera("fisheye", wide=5.0)
    centre, angle = lens_camera.principal_point_px, np.radians([0.0, 30.0, 80.0, 89.9, 90.1])
    slopes = lens_camera.slopes(centre[0] + lens_camera.focal_length_px * angle, centre[1])
    assert slopes[:4, 0] == pytest.approx(np.tan(angle[:4]), rel=1e-9)
    assert np.isnan(slopes[4]).all()


def test_beyond_the_fold_of_the_polynomial_no_ray_exists():
    """r (1 + k1 r^2 + k2 r^4) with k1 = -0.5, k2 = 0.1 rises to r^2 = 1.5 - sqrt(2.25 - 2) = 1."""
    lens_camera = replace(camera("k2"), k1=-0.5, lens=Lens(k2=0.1, p1=1e-4))
    fold = 1 - 0.5 + 0.1
    right = lens_camera.principal_point_px[0] + lens_camera.focal_length_px * fold * np.array([0.999, 1.001])
    slopes = lens_camera.slopes(right, lens_camera.principal_point_px[1])
    assert 0.95 < slopes[0, 0] < 1.0 and np.isnan(slopes[1]).all()


def test_a_camera_keeps_its_lens():
    lens_camera = camera("all terms")
    assert lens_camera.with_parameters(lens_camera.parameters + 0.01).lens == lens_camera.lens
    bent = lens_camera.distorted_further(lambda image_px: 0.3 * np.sin(image_px / 100.0))
    closest = bent.closest_parameters()
    assert closest.lens == lens_camera.lens
    assert np.allclose(closest.project(points()), bent.project(points()), atol=1e-6)
    assert not replace(cornell_camera(64), lens=Lens(aspect=1.01)).is_pinhole


def test_one_term_gives_the_same_as_the_general_formula():
    """The shorter code of a lens of one term, against that of many terms with all the others at zero."""
    plain = replace(cornell_camera(256), k1=-0.15)
    distorted = Lens().distorted(np.array([[0.3, -0.2]]), -0.15)
    expected = plain.focal_length_px * distorted + plain.principal_point_px
    assert plain.at_slopes(np.array([[0.3, -0.2]])) == pytest.approx(expected, abs=1e-12)
    tiny = replace(plain, lens=Lens(k2=1e-300))
    assert np.allclose(tiny.slopes(*np.indices((20, 20)) * 13), plain.slopes(*np.indices((20, 20)) * 13), atol=1e-13)


@pytest.mark.parametrize("term", ["k1", "k2", "k3", "k4", "p1", "p2"])
@pytest.mark.parametrize("name", ["all terms", "fisheye of four terms"])
def test_derivatives_by_a_term_are_differences(name, term):
    k1, lens = LENSES[name]
    if term not in (("k1", "k2", "k3", "k4") if lens.model == "fisheye" else ("k1", "k2", "k3", "p1", "p2")):
        return
    slopes, step = np.random.default_rng(4).uniform(-0.6, 0.6, (20, 2)), 1e-5

    def moved(sign):
        if term == "k1":
            return lens.distorted(slopes, k1 + sign * step)
        return replace(lens, **{term: getattr(lens, term) + sign * step}).distorted(slopes, k1)

    expected = (moved(1) - moved(-1)) / (2 * step)
    np.testing.assert_allclose(lens.term_derivatives(slopes, term), expected, atol=1e-8)
