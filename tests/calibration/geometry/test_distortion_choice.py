"""The distortion model is chosen by prediction; the picture of the fit shows the box where the box is."""

import cv2
import numpy as np
import pytest
from cboxlab.calibration.geometry.camera_fit import SurveyedPoints, fit_camera
from cboxlab.calibration.geometry.distortion_choice import choose_distortion
from cboxlab.calibration.result.geometry_plot import plot_geometry, wireframe
from cboxlab.scenes import cornell_box, cornell_camera

SIGMA_PX = 0.1


def survey(distortion, count=80, seed=1):
    """Points all over the box through OpenCV's own projection with (k1, k2, p1, p2, k3)."""
    rng = np.random.default_rng(seed)
    world = rng.uniform([0, 0, 0], [550, 550, 560], (count, 3))
    camera = cornell_camera(512)
    u, v = camera.principal_point_px
    matrix = np.array([[camera.focal_length_px, 0, u], [0, camera.focal_length_px, v], [0, 0, 1]])
    turn, _ = cv2.Rodrigues(camera.rotation)
    shift = -camera.rotation @ camera.position_mm
    image, _ = cv2.projectPoints(world, turn, shift, matrix, np.array(distortion))
    image = image.reshape(-1, 2) + SIGMA_PX * rng.standard_normal((count, 2))
    points = SurveyedPoints(tuple(f"p{i}" for i in range(count)), world, image)
    return points, fit_camera(points, width_px=512, height_px=512)


@pytest.mark.parametrize("k1", [0.0, -0.08])
def test_a_lens_of_one_term_asks_for_no_more(k1):
    choice = choose_distortion(*survey([k1, 0, 0, 0, 0]))
    assert choice.model in (("none", "k1") if k1 == 0 else ("k1",)) and choice.note is None
    assert choice.held_out_rms_px["k1"] == pytest.approx(SIGMA_PX, rel=0.3)


def test_a_lens_of_two_terms_is_recognised():
    """r is at most 0.45 here: a k2 of 1.5 bends the corner by 6 px, of which k1 takes up a part."""
    choice = choose_distortion(*survey([-0.2, 1.5, 0, 0, 0]))
    assert choice.model in ("k1 k2", "k1 k2 k3")
    assert "held-out" in choice.note
    assert choice.held_out_rms_px[choice.model] < 0.8 * choice.held_out_rms_px["k1"]


def test_decentring_is_recognised():
    choice = choose_distortion(*survey([-0.1, 0, 0.01, -0.008, 0]))
    assert choice.model == "k1 p1 p2"


def test_few_points_choose_nothing():
    assert choose_distortion(*survey([0.0] * 5, count=11)) is None


def test_the_wireframe_is_the_box():
    """Published box: walls of one quad give 4 edges, the ceiling 4 and 4 around the lamp; no diagonals."""
    edges = wireframe(cornell_box())
    box = cornell_box()
    alone = {s.name: len(wireframe(type(box)("one", (s,), {}, box.lamp))) - 4 for s in box.surfaces}
    assert alone["floor"] == 4 and alone["ceiling"] == 8
    assert len(edges) == sum(alone.values()) + 4
    for one in edges:
        assert np.linalg.norm(one[0] - one[1]) > 1


def test_the_picture_is_drawn(tmp_path):
    points, fit = survey([-0.05, 0, 0, 0, 0], count=20)
    photograph = np.random.default_rng(0).uniform(size=(512, 512))
    plot_geometry(photograph, points, fit, fit.camera, cornell_box(), tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10000
