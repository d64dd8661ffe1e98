"""The camera from surveyed points: exact recovery, covariance that covers the truth, mistakes, clear errors.

Stochastic tests have fixed seeds; each verdict's false-alarm rate stands next to it.
"""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cboxlab.calibration.geometry.camera_fit import SurveyedPoints, fit_camera, read_points
from cboxlab.calibration.geometry.camera_jacobian import parameter_jacobian
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.utils.errors import InputError
from helpers.places import SHARED
from scipy import stats
from scipy.spatial.transform import Rotation

CAPTURES = SHARED / "captures"
BOX_MM = np.array([556.0, 548.8, 559.2])
SIGMA_PX = 0.15
NOMINAL_PX = 358.4
SENSOR = {"width_px": 256, "height_px": 256}


def box_camera(rng: np.random.Generator) -> Camera:
    """A camera before the box, off its nominal pose, focal length and principal point by typical amounts."""
    return Camera(
        256,
        256,
        NOMINAL_PX * rng.normal(1, 0.01),
        rng.normal(127.5, 2.0, 2),
        rng.uniform(-0.05, 0.05),
        Rotation.from_rotvec(rng.normal(0, 0.3, 3), degrees=True).as_matrix() @ REFERENCE_ROTATION,
        rng.normal([278.0, 273.0, -800.0], 4.0),
    )


def survey(camera: Camera, count: int, rng: np.random.Generator, sigma_px: float = 0.0) -> SurveyedPoints:
    """Points on the five walls of the box that the camera sees, with Gaussian error in the image."""
    points = np.empty((0, 3))
    while len(points) < count:
        candidates = rng.uniform(0, BOX_MM, (4 * count, 3))
        wall = rng.integers(0, 5, len(candidates))
        axis, end = np.array([0, 0, 1, 1, 2])[wall], np.array([0, 1, 0, 1, 1])[wall]
        candidates[np.arange(len(wall)), axis] = end * BOX_MM[axis]
        image = camera.project(candidates)
        points = np.vstack([points, candidates[np.all((image > 0) & (image < 255), axis=1)]])
    points = points[:count]
    image = camera.project(points) + rng.normal(0, sigma_px, (count, 2))
    return SurveyedPoints(tuple(f"p{i:02d}" for i in range(count)), points, image)


def mahalanobis_square(camera: Camera, true: Camera) -> float:
    difference = camera.parameters - true.parameters
    return float(difference @ np.linalg.solve(camera.covariance, difference))


def test_exact_points_give_back_the_exact_camera() -> None:
    rng = np.random.default_rng(1)
    for nominal in (NOMINAL_PX, None, 0.5 * NOMINAL_PX, 2.2 * NOMINAL_PX):
        true = box_camera(rng)
        fit = fit_camera(survey(true, 30, rng), **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=nominal)
        np.testing.assert_allclose(fit.camera.parameters, true.parameters, atol=1e-5)
        assert fit.reprojection_rms_px < 1e-7 and fit.outliers == ()


def test_no_orientation_of_the_world_is_favoured() -> None:
    """Turning and moving the world turns and moves the camera; the intrinsics and their covariance stay."""
    rng = np.random.default_rng(2)
    points = survey(box_camera(rng), 40, rng, SIGMA_PX)
    reference = fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=NOMINAL_PX)
    half_turns = [np.pi * np.eye(3)[axis] for axis in range(3)]
    for vector in [*half_turns, *rng.normal(0, 2, (6, 3))]:
        turn, shift = Rotation.from_rotvec(vector).as_matrix(), rng.normal(0, 2000, 3)
        moved = replace(points, points_mm=points.points_mm @ turn.T + shift)
        fit = fit_camera(moved, **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=NOMINAL_PX)
        np.testing.assert_allclose(fit.camera.position_mm, turn @ reference.camera.position_mm + shift, atol=1e-3)
        np.testing.assert_allclose(fit.camera.rotation @ turn, reference.camera.rotation, atol=1e-6)
        np.testing.assert_allclose(fit.camera.parameters[6:], reference.camera.parameters[6:], atol=1e-3)
        np.testing.assert_allclose(fit.camera.covariance[6:, 6:], reference.camera.covariance[6:, 6:], rtol=1e-3)


def test_jacobian_agrees_with_finite_differences() -> None:
    rng = np.random.default_rng(3)
    camera = box_camera(rng)
    points = survey(camera, 20, rng).points_mm
    for turn in ([0.0, 0.0, 0.0], [3.0, -8.0, 5.0]):
        camera = camera.with_parameters(np.concatenate([camera.parameters[:3], turn, camera.parameters[6:]]))
        steps = 1e-5 * np.array([1e3] * 3 + [1e2] * 3 + [1e2] * 3 + [1.0])
        numeric = [
            (
                camera.with_parameters(camera.parameters + h).project(points)
                - camera.with_parameters(camera.parameters - h).project(points)
            ).ravel()
            / (2 * h.sum())
            for h in np.diag(steps)
        ]
        exact = parameter_jacobian(camera, points)
        assert np.all(np.abs(exact - np.stack(numeric, 1)) < 1e-6 * np.abs(exact).max(0))


@pytest.mark.parametrize("has_survey", [True, False], ids=["sigma stated", "sigma estimated"])
def test_covariance_covers_the_truth(has_survey: bool) -> None:
    """Over simulated surveys the Mahalanobis square of the ten parameters follows chi2(10).

    Where the sigma is estimated from n = 2 * 50 - 10 degrees of freedom it follows 10 F(10, n). The test of
    the survey itself is calibrated too: p-values are uniform, and points are lost as seldom as stated.
    Each Kolmogorov-Smirnov test raises a false alarm once in 1000 seeds.
    """
    rng = np.random.default_rng(4 + has_survey)
    surveys, squares, p_values, lost = 120, [], [], 0
    for _ in range(surveys):
        true = box_camera(rng)
        points = survey(true, 50, rng, SIGMA_PX)
        fit = fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX if has_survey else None, focal_length_px=NOMINAL_PX)
        squares.append(mahalanobis_square(fit.camera, true))
        lost += bool(fit.outliers)
        assert fit.sigma_estimated != has_survey
        if has_survey:
            p_values.append(fit.p_value)
    expected = stats.chi2(10) if has_survey else stats.f(10, 90, scale=10)
    assert stats.kstest(squares, expected.cdf).pvalue > 1e-3
    assert abs(np.mean(squares) - expected.mean()) < 3.3 * expected.std() / np.sqrt(surveys)
    # Lost surveys are Poisson with mean 0.12 at the stated false-alarm rate of 1e-3: 3 or more once in 3800.
    assert lost < 3
    if has_survey:
        assert stats.kstest(p_values, "uniform").pvalue > 1e-3


def test_mistakes_are_found_named_and_harmless() -> None:
    """Six of fifty points wrong by 2 to 100 px: all are named, and the covariance still covers the truth.

    2 px is 13 sigma; the threshold at a false-alarm rate of 1e-3 for 50 points is 4.7 sigma. The sum of the
    15 Mahalanobis squares at a stated sigma is chi2(150); its 99.9% point is the limit.
    """
    rng = np.random.default_rng(6)
    total = 0.0
    for trial in range(30):
        true = box_camera(rng)
        points = survey(true, 50, rng, SIGMA_PX)
        wrong = np.sort(rng.choice(50, 6, replace=False))
        direction = rng.uniform(0, 2 * np.pi, 6)
        size = np.exp(rng.uniform(np.log(2), np.log(100), 6))
        points.image_px[wrong] += size[:, None] * np.stack([np.cos(direction), np.sin(direction)], -1)
        fit = fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX if trial % 2 else None, focal_length_px=NOMINAL_PX)
        assert fit.outliers == tuple(points.ids[i] for i in wrong)
        assert not np.any(fit.in_use[wrong]) and np.all(np.linalg.norm(fit.residuals_px[wrong], axis=1) > 1.0)
        total += mahalanobis_square(fit.camera, true) if trial % 2 else 0.0
    assert total < stats.chi2.isf(1e-3, 150)


def test_a_mistake_in_the_survey_itself_is_found() -> None:
    """One point whose height was written down 40 mm off."""
    rng = np.random.default_rng(7)
    points = survey(box_camera(rng), 12, rng, SIGMA_PX)
    points.points_mm[5, 1] += 40.0
    assert fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX).outliers == ("p05",)


def test_an_optimistic_sigma_is_reported_and_loses_no_points() -> None:
    """Points that all scatter four times more than stated are no mistakes: the statement is."""
    rng = np.random.default_rng(8)
    points = survey(box_camera(rng), 50, rng, 4 * SIGMA_PX)
    fit = fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=NOMINAL_PX)
    assert fit.outliers == () and fit.p_value is not None and fit.p_value < 1e-6
    # rms^2 is sigma^2 chi2(90) / 100: within five of its standard deviations.
    assert fit.reprojection_rms_px**2 == pytest.approx((4 * SIGMA_PX) ** 2 * 0.9, rel=5 * np.sqrt(2 / 90))


def test_rms_is_per_coordinate() -> None:
    rng = np.random.default_rng(9)
    points = survey(box_camera(rng), 50, rng, SIGMA_PX)
    fit = fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=NOMINAL_PX)
    error = fit.camera.project(points.points_mm) - points.image_px
    assert fit.reprojection_rms_px == pytest.approx(np.sqrt(np.mean(error**2)))
    assert fit.chi2 == pytest.approx(np.sum(error**2) / SIGMA_PX**2)
    assert fit.degrees_of_freedom == 90


def undetermined() -> dict[str, tuple[SurveyedPoints, str]]:
    rng = np.random.default_rng(10)
    camera = box_camera(rng)
    good = survey(camera, 30, rng, SIGMA_PX)

    def with_points(points_mm: np.ndarray) -> SurveyedPoints:
        image = camera.project(points_mm) + rng.normal(0, SIGMA_PX, (len(points_mm), 2))
        return SurveyedPoints(good.ids[: len(points_mm)], points_mm, image)

    back_wall = rng.uniform(50, 500, (30, 3))
    back_wall[:, 2] = BOX_MM[2]
    shallow = back_wall + np.array([0, 0, 1.0]) * rng.uniform(-4, 4, (30, 1))
    tiny = BOX_MM / 2 + rng.uniform(-15, 15, (30, 3))
    aside = tiny + np.array([0, 0.4, 0]) * BOX_MM
    return {
        "five points": (with_points(good.points_mm[:5]), "at least 6"),
        "six coplanar points": (with_points(back_wall[:6]), "one plane"),
        "coplanar points": (with_points(back_wall), "one plane"),
        "nearly coplanar points": (with_points(shallow), "relative uncertainty"),
        "a small part of the image": (with_points(tiny), "of an image of"),
        "a small part aside": (with_points(aside), "of an image of"),
        "points seen by no camera": (replace(good, image_px=rng.uniform(0, 255, (30, 2))), "exchanged"),
        "the same point again": (with_points(np.tile(good.points_mm[:1], (30, 1))), "one plane"),
    }


@pytest.mark.parametrize("name", undetermined())
def test_points_that_cannot_determine_the_camera_are_refused(name: str) -> None:
    points, message = undetermined()[name]
    with pytest.raises(InputError, match=message) as caught:
        fit_camera(points, **SENSOR, point_sigma_px=SIGMA_PX, focal_length_px=NOMINAL_PX)
    assert points.source in str(caught.value) and caught.value.hint


def test_a_sigma_must_be_positive() -> None:
    points = survey(box_camera(np.random.default_rng(11)), 20, np.random.default_rng(11))
    with pytest.raises(InputError, match="point_sigma_px"):
        fit_camera(points, **SENSOR, point_sigma_px=0.0)


GOOD = ["id,x_mm,y_mm,z_mm,u_px,v_px"] + [f"p{i},{i}.5,2,{i * i},{10 * i},4e1" for i in range(6)]


def test_points_are_read_in_any_order_of_columns(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    shuffled = [",".join(np.array(line.split(","))[[4, 0, 3, 5, 2, 1]]) for line in GOOD]
    path.write_text("\ufeff" + "\r\n".join([*shuffled, "", ""]), encoding="utf-8")
    points = read_points(path)
    assert points.ids == ("p0", "p1", "p2", "p3", "p4", "p5") and points.source == str(path)
    np.testing.assert_allclose(points.points_mm[2], [2.5, 2, 4])
    np.testing.assert_allclose(points.image_px[2], [20, 40])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([GOOD[0].replace("z_mm", "depth"), *GOOD[1:]], "no column z_mm"),
        ([GOOD[0] + ",note", *(line + "," for line in GOOD[1:])], "note"),
        ([*GOOD, "p7,1,nan,3,4,5"], "line 8, y_mm: found 'nan'"),
        ([*GOOD, "p7,1,,3,4,5"], "line 8, y_mm"),
        ([*GOOD, "p3,1,2,3,4,5"], "line 8, id: found 'p3' again"),
        ([*GOOD, "p7,1,2,3,4"], "line 8: found 5 cells"),
        (GOOD[:6], "at least 6 points"),
        ([], "no column id"),
    ],
)
def test_faults_of_the_file_are_named(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_points(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_bytes_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.csv"):
        read_points(tmp_path / "absent.csv")
    (tmp_path / "points.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="UTF-8"):
        read_points(tmp_path / "points.csv")


@pytest.mark.skipif(not CAPTURES.exists(), reason="the shared captures are not next to the repository")
@pytest.mark.parametrize("name", ["baseline", "mystery-1", "mystery-2", "mystery-3"])
def test_cameras_of_the_shared_captures(name: str) -> None:
    """Another simulator's cameras, recovered within their covariance (99.9% point of chi2(10): 29.6)."""
    manifest = tomllib.loads((CAPTURES / name / "capture.toml").read_text(encoding="utf-8"))
    answer = json.loads((CAPTURES / "answers.json").read_text(encoding="utf-8"))[name]["true_camera"]
    sensor, sigma = manifest["camera"], manifest["geometry"]["point_sigma_px"]
    size = {"width_px": sensor["width_px"], "height_px": sensor["height_px"]}
    true = Camera(
        **size,
        focal_length_px=answer["fx_px"],
        principal_point_px=np.array([answer["cx_px"], answer["cy_px"]]),
        k1=answer["k1"],
        rotation=np.array(answer["R"]),
        position_mm=np.array(answer["position_mm"]),
    )
    fit = fit_camera(
        read_points(CAPTURES / name / manifest["geometry"]["points"]),
        **size,
        point_sigma_px=sigma,
        focal_length_px=1e3 * manifest["lens"]["focal_length_mm"] / sensor["pixel_pitch_um"],
    )
    assert fit.reprojection_rms_px < 1.15 * sigma
    assert mahalanobis_square(fit.camera, true) < 29.6
    assert fit.outliers == ()
