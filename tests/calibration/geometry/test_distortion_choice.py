"""The distortion model is chosen by prediction; the picture of the fit shows the box where the box is."""

import cv2
import numpy as np
import pytest
from cboxlab.calibration.geometry.camera_fit import FALSE_ALARM, SurveyedPoints, fit_camera
from cboxlab.calibration.geometry.distortion_choice import choose_distortion
from cboxlab.calibration.geometry.lens_model import ONE_TERM
from cboxlab.calibration.geometry.target_adjustment import adjust
from cboxlab.calibration.result.geometry_plot import plot_geometry, wireframe
from cboxlab.scenes import cornell_box, cornell_camera
from scipy.stats import f as f_distribution

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


def choice_of(points, fit, first=ONE_TERM):
    measured = [(points.points_mm[fit.in_use], points.image_px[fit.in_use])]
    return choose_distortion([fit.camera], measured, [1.0], first)


@pytest.mark.parametrize("k1", [0.0, -0.08])
def test_a_lens_of_one_term_asks_for_no_more(k1):
    choice = choice_of(*survey([k1, 0, 0, 0, 0]))
    assert choice.model == ONE_TERM and choice.note is None
    assert choice.held_out_rms_px["k1"] == pytest.approx(SIGMA_PX, rel=0.3)


def test_noise_chooses_no_terms():
    """Ten lenses of one term: one with more terms has a probability of at most 1e-2."""
    names = [choice_of(*survey([-0.08, 0, 0, 0, 0], count=30, seed=seed)).name for seed in range(10)]
    assert set(names) == {"k1"}


def test_a_lens_of_two_terms_is_recognised():
    """r is at most 0.45 here: a k2 of 1.5 bends the corner by 6 px, and k1 can imitate part of that."""
    choice = choice_of(*survey([-0.2, 1.5, 0, 0, 0]))
    assert choice.model.terms == ("k2",)
    assert "held-out" in choice.note
    assert choice.held_out_rms_px[choice.name] < 0.8 * choice.held_out_rms_px["k1"]


def test_decentring_is_recognised():
    assert choice_of(*survey([-0.1, 0, 0.01, -0.008, 0])).name == "k1 p1 p2"


def test_held_out_errors_are_those_of_fits_without_the_points():
    """One step from the fit of all points against ten fits; they differ where the model is not linear."""
    points, fit = survey([-0.2, 1.5, 0, 0, 0], count=40)
    held_out_rms_px = choice_of(points, fit).held_out_rms_px["k1"]
    squares = []
    for fold in np.array_split(np.random.default_rng(0).permutation(40), 10):
        rest = np.setdiff1d(np.arange(40), fold)
        (camera,) = adjust([fit.camera], [(points.points_mm[rest], points.image_px[rest])], [1.0])
        squares.append(np.sum((points.image_px[fold] - camera.project(points.points_mm[fold])) ** 2, axis=1))
    assert held_out_rms_px == pytest.approx(np.sqrt(np.mean(np.concatenate(squares)) / 2), rel=0.02)


@pytest.mark.parametrize("sigma_px", [0.02, 5.0])
def test_held_out_errors_do_not_depend_on_the_unit_of_the_sigma(sigma_px):
    """In pixels; the errors of the fit are divided by the sigma and multiplied again."""
    points, fit = survey([-0.2, 1.5, 0, 0, 0], count=30)
    measured = [(points.points_mm, points.image_px)]
    errors = [
        choose_distortion([fit.camera], measured, [s], ONE_TERM, []).held_out_rms_px["k1"] for s in (1.0, sigma_px)
    ]
    assert errors[1] == pytest.approx(errors[0], rel=1e-9)


#: Few points, so that each degree of freedom counts.
FEW, THREE_TERMS = 14, ONE_TERM.with_terms(("k2", "k3"))


def name_of_choice(monkeypatch, f_ratio, errors, others=(THREE_TERMS,)):
    """Name of the lens where three terms lower the sum of squares by that ratio to Fisher's limit.

    errors : their gain at held-out points, in its standard errors. others : three terms, and lenses that fail.
    """
    freedom = 2 * FEW - (4 + 2) - 6  # focal length, principal point, k1; k2, k3; pose
    limit = f_distribution.isf(FALSE_ALARM / (1 + len(others)), 2, freedom)
    gain = np.random.default_rng(1).standard_normal(FEW)
    gain = (gain - gain.mean()) / gain.std(ddof=1) * np.sqrt(FEW) + errors
    results = {ONE_TERM: (10 + gain, freedom + 2 * limit * f_ratio), THREE_TERMS: (np.full(FEW, 10.0), float(freedom))}

    def held_out(cameras, measured, sigmas, model, folds):
        if model not in results:
            raise np.linalg.LinAlgError
        return results[model]

    monkeypatch.setattr("cboxlab.calibration.geometry.distortion_choice._held_out", held_out)
    monkeypatch.setattr("cboxlab.calibration.geometry.distortion_choice.adjust", lambda starts, *_: starts)
    measured = [(np.zeros((FEW, 3)), np.zeros((FEW, 2)))]
    return choose_distortion([cornell_camera(512)], measured, [1.0], ONE_TERM, others).name


def test_more_terms_need_two_standard_errors_and_a_fit_that_chance_does_not_give(monkeypatch):
    """Just above and just below both limits, which are computed here on their own."""
    assert name_of_choice(monkeypatch, 1.02, 2.05) == "k1 k2 k3"
    assert name_of_choice(monkeypatch, 0.98, 2.05) == "k1"
    assert name_of_choice(monkeypatch, 1.02, 1.95) == "k1"


def test_the_chance_of_a_false_alarm_is_shared_by_all_lenses_that_are_tried(monkeypatch):
    others = (THREE_TERMS, *(ONE_TERM.with_terms(terms) for terms in (("k2",), ("p1", "p2"), ("aspect",))))
    assert name_of_choice(monkeypatch, 1.02, 3.0, others) == "k1 k2 k3"
    assert name_of_choice(monkeypatch, 0.98, 3.0, others) == "k1"


def test_few_points_choose_nothing():
    assert choice_of(*survey([0.0] * 5, count=11)) is None


def test_as_many_numbers_as_coordinates_choose_nothing():
    """Twelve points give 24 coordinates. Four views have 24 numbers, and the lens has more."""
    points, fit = survey([0.0] * 5, count=12)
    views = [(points.points_mm[some], points.image_px[some]) for some in np.arange(12).reshape(4, 3)]
    assert choose_distortion([fit.camera] * 4, views, [1.0] * 4, ONE_TERM) is None


def test_the_wireframe_is_the_box():
    """Published box: walls of one quad give 4 edges, the ceiling 4 and 4 around the lamp; no diagonals."""
    edges = wireframe(cornell_box())
    box = cornell_box()
    alone = {s.name: len(wireframe(type(box)("one", (s,), {}, box.lamp))) - 4 for s in box.surfaces}
    assert alone["floor"] == 4 and alone["ceiling"] == 8
    assert len(edges) == sum(alone.values()) + 4
    for edge in edges:
        assert np.linalg.norm(edge[0] - edge[1]) > 1


def test_the_picture_is_drawn(tmp_path):
    points, fit = survey([-0.05, 0, 0, 0, 0], count=20)
    photograph = np.random.default_rng(0).uniform(size=(512, 512))
    plot_geometry(photograph, points, fit, fit.camera, cornell_box(), tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10000
