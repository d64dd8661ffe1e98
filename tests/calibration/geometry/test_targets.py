"""Flat targets: found to a fraction of a pixel, rendered and real; a lens whose covariance covers the truth.

Stochastic tests have fixed seeds; each verdict's false-alarm rate stands next to it.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.mosaic import channel_mask
from cboxlab.calibration.geometry.camera_calibration import calibrate_camera
from cboxlab.calibration.geometry.camera_fit import fit_camera
from cboxlab.calibration.geometry.surveyed_points import SurveyedPoints
from cboxlab.calibration.geometry.target_camera import fit_camera_targets
from cboxlab.calibration.geometry.targets import TargetView, detect_target
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.calibration.result.write import calibration_record
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from helpers.captures.board_capture import (
    FOCAL_LENGTH_PX,
    HEIGHT,
    INTRINSICS,
    K1,
    PITCH_MM,
    PRINCIPAL_POINT_PX,
    TILTS_DEG,
    WIDTH,
    Pattern,
    board_capture,
    camera_before,
    centre,
    chessboard,
    photograph,
)
from helpers.places import SHARED
from scipy import stats
from scipy.spatial.transform import Rotation

DISKS = SHARED / "real" / "seven-band-disks"


def disks(rows: int, columns: int, radius_mm: float, dark: float = 0.05, light: float = 0.8) -> Pattern:
    def reflectance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        i = np.clip(np.round(x / PITCH_MM), 0, columns - 1)
        j = np.clip(np.round(y / PITCH_MM), 0, rows - 1)
        return np.where(np.hypot(x - i * PITCH_MM, y - j * PITCH_MM) < radius_mm, dark, light)

    return reflectance


def charuco(rows: int, columns: int, marker_share: float) -> Pattern:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), 1.0, marker_share, dictionary)
    scale = 40
    texture = board.generateImage(((columns + 1) * scale, (rows + 1) * scale)) / 255.0

    def reflectance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        i = np.floor((x / PITCH_MM + 1) * scale).astype(int)
        j = np.floor((y / PITCH_MM + 1) * scale).astype(int)
        inside = (i >= 0) & (i < texture.shape[1]) & (j >= 0) & (j < texture.shape[0])
        ink = texture[np.clip(j, 0, texture.shape[0] - 1), np.clip(i, 0, texture.shape[1] - 1)]
        return np.where(inside, 0.05 + 0.75 * ink, 0.8)

    return reflectance


def detection_errors(view: TargetView, camera: Camera, rows: int, columns: int) -> np.ndarray:
    """(n, 2) px; of the two ways round that a symmetric pattern may be read, the one it was read in."""
    world, image = view
    turned = 2 * centre(rows, columns) - world
    errors = [image - camera.project(points) for points in (world, turned)]
    return min(errors, key=lambda error: float(np.sum(error**2)))


@pytest.mark.parametrize(
    ("kind", "rows", "columns", "fewest", "pattern"),
    [
        ("chessboard", 5, 7, 35, chessboard(5, 7)),
        ("circles", 5, 7, 35, disks(5, 7, 5.0)),
        ("circles", 5, 7, 35, disks(5, 7, 5.0, dark=0.8, light=0.05)),
        ("charuco", 3, 5, 15, charuco(3, 5, 0.75)),
        ("charuco", 3, 5, 6, charuco(3, 5, 0.6)),
    ],
    ids=["chessboard", "dark disks", "light disks", "charuco", "charuco, small markers"],
)
def test_targets_are_found_and_give_the_lens(kind: str, rows: int, columns: int, fewest: int, pattern: Pattern) -> None:
    """Five tilted views of a rendered target, noisy, through a lens with 1% distortion at the corner."""
    rng = np.random.default_rng(1)
    views, errors = [], []
    for tilt in TILTS_DEG:
        camera = camera_before(centre(rows, columns), tilt, 42.0 * (columns + 1))
        view = detect_target(photograph(camera, pattern, rng), kind, rows, columns, PITCH_MM)
        assert fewest <= len(view[0]) <= rows * columns
        views.append(view)
        errors.append(detection_errors(view, camera, rows, columns))
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.1
    fit = fit_camera_targets(views, width_px=WIDTH, height_px=HEIGHT)
    assert fit.reprojection_rms_px < 0.1
    deviation = np.sqrt(np.diag(fit.intrinsics_covariance))
    # Detection errors are not purely random; they may take the place of three more standard deviations.
    assert np.all(np.abs(fit.intrinsics - INTRINSICS) < 6 * deviation)
    assert deviation[0] < 0.01 * FOCAL_LENGTH_PX


@pytest.mark.parametrize("mosaic", ["GBRG", "RGGB"])
def test_a_target_behind_a_mosaic_gives_the_lens_in_whole_pixels(tmp_path: Path, mosaic: str) -> None:
    """Red and blue are half as bright. Half the resolution doubles what detection errs by."""
    rng = np.random.default_rng(6)
    names = []
    green = channel_mask(mosaic, (HEIGHT, WIDTH), "G")
    for index, tilt in enumerate(TILTS_DEG):
        camera = camera_before(centre(5, 7), tilt, 42.0 * 8)
        image = photograph(camera, chessboard(5, 7), rng) * np.where(green, 1.0, 0.5)
        names.append(f"target-{index}.tif")
        tifffile.imwrite(tmp_path / names[-1], np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    tifffile.imwrite(tmp_path / "scene.tif", np.full((HEIGHT, WIDTH), 1000, np.uint16))
    (tmp_path / "capture.toml").write_text(
        f"""
format = "capture/1"
camera = {{ width_px = {WIDTH}, height_px = {HEIGHT}, bit_depth = 12 }}
mosaic = {{ pattern = "{mosaic}" }}
band = [{{ id = "f550", exposure_s = 1.0, frames = ["scene.tif"] }}]
target = [{{ kind = "chessboard", rows = 5, columns = 7, pitch_mm = {PITCH_MM}, frames = {names} }}]
"""
    )
    _, fit, notes = calibrate_camera(load_capture(tmp_path))
    assert fit is not None, notes
    assert fit.reprojection_rms_px < 0.4
    deviation = np.sqrt(np.diag(fit.intrinsics_covariance))
    assert np.all(np.abs(fit.intrinsics - INTRINSICS) < 6 * deviation)
    assert np.all(deviation[:3] < 5.0)


def test_the_file_of_a_bad_view_is_named(tmp_path: Path) -> None:
    """The board of one photograph is 10 % wider than stated: it is not used, and calibration.json names its file."""
    board_capture(tmp_path)
    _, fit, notes = calibrate_camera(load_capture(tmp_path))
    assert fit is not None and [view.name for view in fit.discordant] == ["target-2.tif"]
    assert notes[0].startswith("target view not used: target-2.tif: its points scatter by ")
    assert abs(fit.intrinsics[0] - FOCAL_LENGTH_PX) < 6 * np.sqrt(fit.intrinsics_covariance[0, 0])
    assert set(notes) <= set(calibration_record(calibrate_capture(load_capture(tmp_path)))["notes"])


def test_a_disk_is_found_where_it_is_whatever_the_shading() -> None:
    """Seen straight on, a disk's centroid is its centre: strong shading moves it by less than 0.02 px."""
    rng = np.random.default_rng(2)
    camera = camera_before(centre(3, 4), (0, 0, 0), 330.0)
    image = photograph(camera, disks(3, 4, 6.0), rng)
    ramp = np.linspace(0.6, 1.4, WIDTH)
    views = [detect_target(frame, "circles", 3, 4, PITCH_MM) for frame in (image, image * ramp)]
    difference = views[1][1] - views[0][1]
    assert np.abs(difference.mean(0)).max() < 0.02
    assert np.sqrt(np.mean(detection_errors(views[1], camera, 3, 4) ** 2)) < 0.05


def test_disks_cut_by_the_edge_are_left_out() -> None:
    rng = np.random.default_rng(3)
    camera = camera_before(centre(5, 7), (0, 0, 0), 330.0)
    image = photograph(camera, disks(5, 7, 6.0), rng)
    column, top = np.round(camera.project(np.zeros((1, 3)))[0]).astype(int)
    view = detect_target(image[top:, column:], "circles", 4, 6, PITCH_MM)
    expected = camera.project(PITCH_MM * np.array([[1.0, 1.0, 0], [6.0, 4.0, 0]])) - [column, top]
    for disk_centre in expected:
        assert np.linalg.norm(view[1] - disk_centre, axis=1).min() < 0.1


def test_a_charuco_board_may_be_partly_covered() -> None:
    rng = np.random.default_rng(4)
    camera = camera_before(centre(3, 5), (20, 10, 5), 250.0)
    image = photograph(camera, charuco(3, 5, 0.75), rng)
    image[:, :120] = 500.0
    view = detect_target(image, "charuco", 3, 5, PITCH_MM)
    assert 6 <= len(view[0]) < 15
    assert np.sqrt(np.mean((view[1] - camera.project(view[0])) ** 2)) < 0.15


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "checkers"}, "one of chessboard, circles, charuco"),
        ({"rows": 1}, "1 x 7"),
        ({"pitch_mm": 0.0}, "pitch above 0"),
        ({"image": np.zeros((60, 80, 3))}, "one channel"),
        ({"image": np.full((60, 80), np.nan)}, "finite"),
        ({"kind": "chessboard"}, "no chessboard of 5 x 7"),
        ({"kind": "circles"}, "no circles of 5 x 7"),
        ({"kind": "charuco"}, "no charuco of 5 x 7"),
    ],
)
def test_what_cannot_be_found_is_said(changes: dict, message: str) -> None:
    noise = np.random.default_rng(5).normal(100, 5, (60, 80))
    arguments = {"image": noise, "kind": "circles", "rows": 5, "columns": 7, "pitch_mm": PITCH_MM} | changes
    with pytest.raises(InputError, match=message):
        detect_target(**arguments, source="frames/t.tif")


def simulated_views(rng: np.random.Generator, sigma_px: float) -> list[TargetView]:
    steps = np.stack([*np.meshgrid(np.arange(7.0), np.arange(5.0)), np.zeros((5, 7))], -1)
    grid = PITCH_MM * steps.reshape(-1, 3)
    views = []
    for tilt in TILTS_DEG:
        turn = np.array(tilt) + rng.normal(0, 3, 3)
        camera = camera_before(centre(5, 7) + rng.normal(0, 10, 3), (turn[0], turn[1], turn[2]), 330.0)
        views.append((grid, camera.project(grid) + rng.normal(0, sigma_px, (35, 2))))
    return views


def square(covariance: np.ndarray, difference: np.ndarray) -> float:
    return float(difference @ np.linalg.solve(covariance, difference))


@pytest.mark.parametrize("has_survey", [True, False], ids=["sigma stated", "sigma estimated"])
def test_covariance_of_the_intrinsics_covers_the_truth(has_survey: bool) -> None:
    """The Mahalanobis square of 80 calibrations follows chi2(4), or 4 F(4, n) (false alarm 1e-3)."""
    rng = np.random.default_rng(6 + has_survey)
    squares = []
    for _ in range(80):
        fit = fit_camera_targets(
            simulated_views(rng, 0.1),
            width_px=WIDTH,
            height_px=HEIGHT,
            point_sigma_px=0.1 if has_survey else None,
        )
        squares.append(square(fit.intrinsics_covariance, fit.intrinsics - INTRINSICS))
    assert fit.degrees_of_freedom == 5 * 70 - 4 - 5 * 6
    expected = stats.chi2(4) if has_survey else stats.f(4, fit.degrees_of_freedom, scale=4)
    assert stats.kstest(squares, expected.cdf).pvalue > 1e-3


def surveyed_box(rng: np.random.Generator, sigma_px: float) -> tuple[Camera, SurveyedPoints]:
    turn = Rotation.from_rotvec(rng.normal(0, 0.5, 3), degrees=True).as_matrix() @ np.diag([-1.0, -1.0, 1.0])
    camera = Camera(WIDTH, HEIGHT, FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX, K1, turn, rng.normal([278, 273, -1000], 5))
    points = rng.uniform(0, 550, (16, 3))
    image = camera.project(points) + rng.normal(0, sigma_px, (16, 2))
    return camera, SurveyedPoints(tuple(f"p{i}" for i in range(16)), points, image)


def test_a_joint_fit_sharpens_the_surveyed_camera_and_still_covers_it() -> None:
    """Surveys of 16 points with targets of the same lens: the Mahalanobis square is chi2(10).

    Kolmogorov-Smirnov over 40 of them, false alarm 1e-3.

    The targets know the lens better than 16 points do, and focal length trades against distance: the joint
    camera stands at least three times firmer in depth.
    """
    rng = np.random.default_rng(8)
    squares, gains = [], []
    for trial in range(40):
        true, points = surveyed_box(rng, 0.15)
        alone = fit_camera(points, width_px=WIDTH, height_px=HEIGHT, point_sigma_px=0.15)
        joint = fit_camera_targets(
            simulated_views(rng, 0.05),
            width_px=WIDTH,
            height_px=HEIGHT,
            point_sigma_px=0.05 if trial % 2 else None,
            survey=(points, alone),
        ).survey_camera
        squares.append(square(joint.covariance, joint.parameters - true.parameters))
        gains.append(alone.camera.covariance[2, 2] / joint.covariance[2, 2])
    assert stats.kstest(squares, stats.chi2(10).cdf).pvalue > 1e-3
    assert np.sqrt(np.median(gains)) > 3


def test_views_that_cannot_determine_the_lens_are_refused() -> None:
    rng = np.random.default_rng(9)
    views = simulated_views(rng, 0.05)
    size = {"width_px": WIDTH, "height_px": HEIGHT}
    with pytest.raises(InputError, match="at least two"):
        fit_camera_targets(views[:1], **size)
    with pytest.raises(InputError, match="view 2: found 4 points"):
        fit_camera_targets([views[0], (views[1][0][:4], views[1][1][:4])], **size)
    flat = []
    for distance in (300.0, 330.0, 360.0):
        camera = camera_before(centre(5, 7), (0, 0, 0), distance)
        flat.append((views[0][0], camera.project(views[0][0]) + rng.normal(0, 0.05, (35, 2))))
    with pytest.raises(InputError, match=r"focal length|determine"):
        fit_camera_targets(flat, **size)


def real_disks(name: str, row: int, column: int) -> np.ndarray:
    """(30, 2) disk centres in pixels of the whole frame, from one colour of the mosaic."""
    frame = tifffile.imread(DISKS / "frames" / name).astype(float)
    _, image = detect_target(frame[row::2, column::2], "circles", 5, 6, 8.0, name)
    return 2 * image + [1632 + column, 1364 + row]


@pytest.mark.skipif(not DISKS.exists(), reason="the shared real frames are not next to the repository")
def test_disks_of_a_real_mosaic_frame() -> None:
    """GBRG: the two greens are separate samples of the same picture, so that their centres must agree.

    They are one pixel apart on the diagonal; a wrong convention for pixel positions would show as 0.5 px.
    Neighbouring centres lie a constant step apart, to first order: a grid read in the wrong order would not.
    """
    first, second = (real_disks("disks-f550-25ms.tif", i, i) for i in (0, 1))
    assert np.abs((second - first).mean(0)).max() < 0.03
    assert np.sqrt(np.mean((second - first) ** 2)) < 0.08
    grid = first.reshape(5, 6, 2)
    # The frame is crisp and the distortion mild: straight rows, whose second differences are small.
    assert np.abs(np.diff(grid, 2, axis=1)).max() < 0.6
    steps = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    assert 60 < steps.min() and steps.max() < 75


@pytest.mark.skipif(not DISKS.exists(), reason="the shared real frames are not next to the repository")
@pytest.mark.parametrize(
    ("name", "row", "column", "published_px"),
    [
        ("disks-f500-100ms.tif", 0, 0, -np.hypot(0.79, 0.65)),
        ("disks-f600-100ms.tif", 1, 0, np.hypot(0.83, 0.68)),
        ("disks-f600-100ms.tif", 0, 0, np.hypot(0.82, 0.67)),
        ("disks-f650-250ms.tif", 1, 0, np.hypot(1.63, 1.30)),
        ("disks-f700-2000ms.tif", 1, 0, np.hypot(2.48, 1.98)),
    ],
)
def test_lateral_colour_of_the_real_lens(name: str, row: int, column: int, published_px: float) -> None:
    """The magnification against 550 nm, radial about the frame's centre, is that of the capture's description

    (its mean shift at 798 px from the centre) within 10%: it averaged 22 of the 30 disks.
    """
    green = np.mean([real_disks("disks-f550-25ms.tif", i, i) for i in (0, 1)], axis=0)
    from_centre = green - [(2448 - 1) / 2, (2048 - 1) / 2]
    shift = real_disks(name, row, column) - green
    growth = np.sum(shift * from_centre) / np.sum(from_centre**2)
    assert growth == pytest.approx(published_px / 798, rel=0.1)
    assert np.sqrt(np.mean((shift - growth * from_centre) ** 2)) < 0.15
