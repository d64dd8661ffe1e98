"""Lenses of more terms, recovered from simulated points and boards; boards at a stated place; stated lenses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.geometry import calibrate_camera, camera_calibration
from cboxlab.calibration.geometry.camera_fit import SurveyedPoints, fit_camera
from cboxlab.calibration.geometry.camera_jacobian import parameter_jacobian, term_jacobian
from cboxlab.calibration.geometry.lens_model import LensModel
from cboxlab.calibration.geometry.placed_boards import BoardPlace, placed_points
from cboxlab.calibration.geometry.target_camera import fit_camera_targets
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.lens import LENS_TERMS, Lens
from cboxlab.utils.errors import InputError
from scipy import stats
from scipy.spatial.transform import Rotation

POLYNOMIAL = Lens(k2=0.4, k3=-0.3, p1=0.004, p2=-0.003, aspect=1.02)
FISHEYE = Lens("fisheye", k2=0.05, k3=-0.02, k4=0.01, aspect=0.99)
LENSES = {"polynomial": (-0.2, POLYNOMIAL), "fisheye": (-0.03, FISHEYE)}
SIGMA_PX = 0.05


def box_camera(name):
    k1, lens = LENSES[name]
    true_camera = cornell_camera(512).with_parameters([270.0, 280.0, -560.0, 1.0, -2.0, 0.5, 520.0, 250.0, 262.0, k1])
    return replace(true_camera, lens=lens)


def box_survey(camera, count, rng, sigma_px=SIGMA_PX):
    points = rng.uniform(0, 550, (20 * count, 3))
    image = camera.project(points)
    points = points[np.all((image > 0) & (image < 511), axis=1)][:count]
    image = camera.project(points) + sigma_px * rng.standard_normal((count, 2))
    return SurveyedPoints(tuple(f"p{i}" for i in range(count)), points, image)


@pytest.mark.parametrize("name", LENSES)
def test_derivatives_are_those_of_finite_differences(name):
    camera, points = box_camera(name), np.random.default_rng(2).uniform(0, 550, (40, 3))
    steps = np.diag([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-5])

    def image(step):
        return camera.with_parameters(camera.parameters + step).project(points).ravel()

    expected = np.stack([(image(step) - image(-step)) / (2 * step.max()) for step in steps], axis=1)
    assert np.allclose(parameter_jacobian(camera, points), expected, rtol=1e-5, atol=1e-4)
    terms = LENS_TERMS[camera.lens.model]
    for term, column in zip(terms, term_jacobian(camera, points, terms).T, strict=True):
        value = getattr(camera.lens, term)
        ahead, behind = (
            replace(camera, lens=replace(camera.lens, **{term: value + h})).project(points) for h in (1e-5, -1e-5)
        )
        assert np.allclose(column, (ahead - behind).ravel() / 2e-5, rtol=1e-5, atol=1e-4), term


@pytest.mark.parametrize("name", LENSES)
def test_a_survey_gives_all_terms_within_their_errors(name):
    """The squared distance from the truth over the covariance follows chi2; false alarm 1e-3."""
    true, rng = box_camera(name), np.random.default_rng(4)
    model = LensModel(Lens(true.lens.model), LENS_TERMS[true.lens.model])
    points = box_survey(true, 120, rng)
    fit = fit_camera(points, width_px=512, height_px=512, point_sigma_px=SIGMA_PX, model=model)
    difference = model.values(fit.camera) - model.values(true)
    jacobian = model.jacobian(true, points.points_mm) / SIGMA_PX
    square = float(np.sum((jacobian @ difference) ** 2))
    assert stats.chi2.ppf(1e-3, model.count) < square < stats.chi2.isf(1e-3, model.count)
    assert 1e-3 < fit.p_value < 1 - 1e-3 and fit.degrees_of_freedom == 240 - model.count
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    for index, term in enumerate(model.terms):
        expected = np.sqrt(inverse[10 + index, 10 + index])
        assert fit.lens_sigmas[term] == pytest.approx(expected, rel=0.05)
    assert np.diag(fit.camera.covariance) == pytest.approx(np.diag(inverse)[:10], rel=0.05)


def boards(camera, rng, count=8, sigma_px=SIGMA_PX):
    """Views of a board of 9 x 6 corners all over the picture, tilted in several directions."""
    grid = 25.0 * np.stack([*np.meshgrid(np.arange(9.0), np.arange(6.0)), np.zeros((6, 9))], -1).reshape(-1, 3)
    views = []
    while len(views) < count:
        turn = Rotation.from_euler("xyz", rng.uniform(-35, 35, 3), degrees=True).as_matrix()
        middle = np.array([*rng.uniform(-80, 80, 2), rng.uniform(260, 340)])
        before = replace(camera, rotation=turn, position_mm=grid.mean(axis=0) - turn.T @ middle, covariance=None)
        image = before.project(grid)
        if np.all((image > 5) & (image < 506)):
            views.append((grid, image + sigma_px * rng.standard_normal(image.shape)))
    return views


@pytest.mark.parametrize("name", LENSES)
def test_boards_give_all_terms_within_their_errors(name):
    true, rng = box_camera(name), np.random.default_rng(6)
    model = LensModel(Lens(true.lens.model), LENS_TERMS[true.lens.model])
    fit = fit_camera_targets(boards(true, rng), width_px=512, height_px=512, point_sigma_px=SIGMA_PX, model=model)
    assert not fit.discordant and fit.reprojection_rms_px == pytest.approx(SIGMA_PX, rel=0.1)
    lens = fit.cameras[0].lens
    for term, sigma in fit.lens_sigmas.items():
        assert abs(getattr(lens, term) - getattr(true.lens, term)) < 4.5 * sigma, term
    square = np.linalg.solve(fit.intrinsics_covariance, fit.intrinsics - true.parameters[6:]) @ (
        fit.intrinsics - true.parameters[6:]
    )
    assert square < stats.chi2.isf(1e-3, 4)


def written(folder: Path, camera, points=None, lens="", targets="", sigma_px=SIGMA_PX):
    """A capture with one dark frame of a scene, surveyed points and targets."""
    (folder / "scene.tif").parent.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(folder / "scene.tif", np.full((camera.height_px, camera.width_px), 100, np.uint16))
    geometry = ""
    if points is not None:
        rows = [
            ",".join([name, *(f"{x:.9f}" for x in (*world, *image))])
            for name, world, image in zip(points.ids, points.points_mm, points.image_px, strict=True)
        ]
        (folder / "points.csv").write_text("\n".join(["id,x_mm,y_mm,z_mm,u_px,v_px", *rows]))
        geometry = f'[geometry]\npoints = "points.csv"\npoint_sigma_px = {sigma_px}\n'
    (folder / "capture.toml").write_text(
        f"""format = "capture/1"
[camera]
width_px = {camera.width_px}
height_px = {camera.height_px}
bit_depth = 12
[lens]
{lens}
[[band]]
id = "f550"
exposure_s = 1.0
frames = ["scene.tif"]
{geometry}
{targets}
"""
    )
    return load_capture(folder)


@pytest.mark.parametrize("name", LENSES)
def test_a_capture_is_seen_through_the_lens_that_its_points_choose(name, tmp_path):
    """The old lens leaves 0.3 px and more; the note names the lens in use."""
    true, rng = box_camera(name), np.random.default_rng(8)
    fit, _, notes = calibrate_camera(written(tmp_path, true, box_survey(true, 150, rng)))
    assert fit.camera.lens.model == name and fit.p_value > 1e-3 and not fit.outliers
    assert any("is in use" in note and "held-out" in note for note in notes)
    corners = rng.uniform(0, 550, (300, 3))
    inside = np.all((true.project(corners) > 0) & (true.project(corners) < 511), axis=1)
    assert fit.camera.motion_px(true, corners[inside]) < 2 * SIGMA_PX


def test_a_stated_lens_is_not_fitted_and_its_contradiction_is_noted(tmp_path):
    true, rng = box_camera("polynomial"), np.random.default_rng(9)
    points = box_survey(true, 60, rng)
    terms = f"[-0.2, {POLYNOMIAL.k2}, {POLYNOMIAL.p1}, {POLYNOMIAL.p2}, {POLYNOMIAL.k3}]"
    lens_text = f"fx_px = 520.0\nfy_px = {520.0 * 1.02}\ndistortion = {terms}"
    fit, _, notes = calibrate_camera(written(tmp_path / "right", true, points, lens_text))
    assert (fit.camera.focal_length_px, fit.camera.k1) == (520.0, -0.2)
    assert fit.camera.lens == replace(POLYNOMIAL, aspect=pytest.approx(1.02))
    assert fit.degrees_of_freedom == 120 - 8 and fit.p_value > 1e-3 and not notes
    assert np.all(np.linalg.eigvalsh(fit.camera.covariance) > 0)
    wrong = lens_text.replace("fx_px = 520.0", "fx_px = 505.0")
    _, _, notes = calibrate_camera(written(tmp_path / "wrong", true, points, wrong))
    assert any("do not agree with the lens that [lens] states" in note for note in notes)


GRID = 25.0 * np.stack([*np.meshgrid(np.arange(9.0), np.arange(6.0)), np.zeros((6, 9))], -1).reshape(-1, 3)


def board_capture(monkeypatch, folder, frames, rng, lens=""):
    """A capture with boards whose points are "detected" at their images; the first one's place is stated.

    frames : place of the board and camera of each picture.
    """
    tables, corners = [], {}
    for number, (board, camera) in enumerate(frames):
        name = f"board-{number}.tif"
        folder.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(folder / name, np.full((512, 512), number, np.uint16))
        image = camera.project(board.in_box(GRID))
        assert np.all((image > 0) & (image < 511))
        corners[name] = GRID, image + SIGMA_PX * rng.standard_normal(image.shape)
        table = f'[[target]]\nkind = "chessboard"\nrows = 6\ncolumns = 9\npitch_mm = 25.0\nframes = ["{name}"]\n'
        if number == 0:
            right, down = (board.axes[:, i].tolist() for i in (0, 1))
            table += f"origin_mm = {board.origin_mm.tolist()}\nright = {right}\ndown = {down}\n"
        tables.append(table)
    monkeypatch.setattr(camera_calibration, "detect_target", lambda *arguments: corners[arguments[-1]])
    return written(folder, frames[0][1], None, lens, "\n".join(tables))


BACK = BoardPlace(np.array([378.0, 340.0, 559.2]), np.diag([-1.0, -1.0, 1.0]), True)


def test_a_board_at_a_known_place_gives_the_pose(monkeypatch, tmp_path):
    """The lens is stated; the covariance covers the truth (chi2 of the six parameters of the pose, 1e-3)."""
    true, rng = replace(box_camera("polynomial"), position_mm=np.array([250.0, 300.0, 60.0])), np.random.default_rng(3)
    terms = f"[-0.2, {POLYNOMIAL.k2}, {POLYNOMIAL.p1}, {POLYNOMIAL.p2}, {POLYNOMIAL.k3}]"
    lens = f"fx_px = 520.0\nfy_px = {520.0 * 1.02}\ndistortion = {terms}"
    turned = Rotation.from_euler("xyz", [12.0, -20.0, 5.0], degrees=True).as_matrix()
    board = replace(BACK, origin_mm=np.array([350.0, 330.0, 400.0]), axes=turned @ BACK.axes)
    fit, targets, notes = calibrate_camera(board_capture(monkeypatch, tmp_path, [(board, true)], rng, lens))
    assert targets is not None and fit.reprojection_rms_px < 0.06
    assert fit.reprojection_rms_px**2 == pytest.approx(np.mean(np.square(fit.residuals_px)))
    assert any("camera's pose is that before board-0.tif" in note for note in notes)
    difference = fit.camera.parameters - true.parameters
    assert float(difference @ np.linalg.solve(fit.camera.covariance, difference)) < stats.chi2.isf(1e-3, 10)
    assert np.abs(difference[:3]).max() < 2.0


def test_the_lens_of_the_pose_comes_from_all_boards(monkeypatch, tmp_path):
    true, rng = replace(box_camera("polynomial"), position_mm=np.array([250.0, 300.0, 60.0])), np.random.default_rng(5)
    others = []
    for euler in ([25, 10, 0], [-25, 20, 10], [10, -30, 5], [-15, -25, -8], [30, 5, 90], [5, 32, 45]):
        turned = Rotation.from_euler("xyz", euler, degrees=True).as_matrix() @ BACK.axes
        middle = np.array([250.0, 300.0, 380.0]) - 25.0 * turned @ [4.0, 2.5, 0.0]
        others.append((replace(BACK, origin_mm=middle, axes=turned), true))
    board = replace(BACK, origin_mm=np.array([350.0, 360.0, 400.0]))
    fit, targets, _ = calibrate_camera(board_capture(monkeypatch, tmp_path, [(board, true), *others], rng))
    assert len(targets.cameras) == 7 and not fit.camera.lens.one_term
    corners = np.random.default_rng(0).uniform([150, 200, 350], [350, 400, 550], (200, 3))
    assert fit.camera.motion_px(true, corners) < 0.3
    assert (
        np.abs(fit.camera.position_mm - true.position_mm).max() < 5 * np.sqrt(np.diag(fit.camera.covariance)[:3]).max()
    )


def test_half_a_turn_of_the_pattern_does_not_turn_the_camera():
    """A detection in either order gives the upright camera."""
    true = cornell_camera(512)
    grid = 25.0 * np.stack([*np.meshgrid(np.arange(9.0), np.arange(6.0)), np.zeros((6, 9))], -1).reshape(-1, 3)
    image = true.project(BACK.in_box(grid))
    for view in ((grid, image), (grid, image[::-1])):
        motion = BACK.axes if view[1] is image else BACK.axes @ np.diag([-1.0, -1.0, 1.0])
        origin = BACK.origin_mm if view[1] is image else BACK.in_box(grid[-1:])[0]
        before = replace(true, rotation=true.rotation @ motion, position_mm=motion.T @ (true.position_mm - origin))
        assert np.allclose(before.project(grid), view[1], atol=1e-6)
        points, camera = placed_points([view], [BACK], [before], ["board"])
        assert np.allclose(camera.position_mm, true.position_mm) and np.allclose(camera.rotation, true.rotation)
        assert np.allclose(camera.project(points.points_mm), points.image_px, atol=1e-6)


@pytest.mark.parametrize(
    ("lens", "target", "message"),
    [
        ("fy_px = 500.0", "", "no fx_px with it"),
        ("distortion = [0.1, 0.2]", "", "2 numbers; expected 5: k1, k2, p1, p2, k3"),
        ('model = "fisheye"\ndistortion = [0.1, 0, 0, 0, 0]', "", "5 numbers; expected 4: k1, k2, k3, k4 of a fisheye"),
        ('model = "wide"', "", "lens.model"),
        ("fx_px = -5.0", "", "lens.fx_px"),
        ("", "origin_mm = [0.0, 0.0, 0.0]", "origin_mm without right, down"),
        ("", "origin_mm = [0, 0, 0]\nright = [2, 0, 0]\ndown = [0, 1, 0]", "length 2; expected a unit vector"),
        ("", "origin_mm = [0, 0, 0]\nright = [1, 0, 0]\ndown = [0.6, 0.8, 0]", "53.13 degrees to right; expected 90"),
        ("", "origin_mm = [0, 0]\nright = [1, 0, 0]\ndown = [0, 1, 0]", "origin_mm"),
    ],
)
def test_wrong_values_are_named(lens, target, message, tmp_path):
    camera = cornell_camera(32)
    table = '[[target]]\nkind = "chessboard"\nrows = 4\ncolumns = 5\npitch_mm = 10.0\nframes = ["scene.tif"]\n'
    with pytest.raises(InputError, match=message):
        written(tmp_path, camera, None, lens, table + target if target else "")
