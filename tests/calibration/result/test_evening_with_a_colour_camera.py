"""An evening with a colour camera, as in the how-to: a folder of raw files, from their names to the camera."""

import cv2
import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.capture.first_manifest import ManifestEntry, write_first_manifest
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.quality.content import check_same_view
from cboxlab.calibration.quality.frame_checks.stacks import read_stacks
from cboxlab.calibration.result import calibrate_capture
from helpers.files.frame_files import write_dng

SIDE, FOCAL_PX, GAIN, READ_E, WHITE = 160, 224.0, 2.5, 4.0, 4095
COLUMNS, ROWS, PITCH_MM = 9, 6, 25.0
POSITION_MM = np.array([278.0, 273.0, -800.0])
#: How the board is held, as a rotation vector and the place of its first corner before the lens, mm.
POSES = (
    ((0.0, 0.0, 0.0), (-100, -62, 460)),
    ((0.4, 0.0, 0.0), (-100, -62, 470)),
    ((-0.4, 0.0, 0.1), (-100, -62, 470)),
    ((0.0, 0.45, 0.0), (-90, -62, 470)),
    ((0.0, -0.3, -0.1), (-95, -55, 490)),
)


def photograph(rng, light):
    """(y, x) counts of light (y, x) in counts."""
    electrons = rng.poisson(GAIN * light) + READ_E * rng.standard_normal(light.shape)
    return np.clip(np.rint(electrons / GAIN + 64), 0, WHITE).astype(np.uint16)


def board(turn, corner_mm, samples=2):
    """(y, x) reflectance of a printed board before the lens, by the ray of each sample of a pixel."""
    rotation, corner_mm = cv2.Rodrigues(np.array(turn))[0], np.array(corner_mm, float)
    v, u = (np.indices((SIDE * samples,) * 2) + 0.5) / samples - 0.5 - (SIDE - 1) / 2
    rays = np.stack([u / FOCAL_PX, v / FOCAL_PX, np.ones_like(u)], axis=-1)
    distance = (rotation[:, 2] @ corner_mm) / (rays @ rotation[:, 2])
    across, down = np.moveaxis(((rays * distance[..., None] - corner_mm) @ rotation)[..., :2] / PITCH_MM, -1, 0)
    squares = (across > -1) & (across < COLUMNS) & (down > -1) & (down < ROWS)
    paper = (across > -1.5) & (across < COLUMNS + 0.5) & (down > -1.5) & (down < ROWS + 0.5)
    dark = squares & ((np.floor(across) + np.floor(down)) % 2 == 0)
    return np.where(dark, 0.05, np.where(paper, 0.85, 0.3)).reshape(SIDE, samples, SIDE, samples).mean(axis=(1, 3))


def evening(folder, board_name="board-IMG_{:04d}", dark_name="dark-{:04d}"):
    """Photographs of boards, two of a wall, four of a box and four with the lens covered, as a camera numbers them."""
    rng = np.random.default_rng(4)
    v, u = np.indices((SIDE, SIDE)) / SIDE
    box = 200 + 2000 * (0.2 + u) * (1 - 0.6 * v) * (1 + 0.3 * (np.hypot(u - 0.4, v - 0.6) < 0.2)) / 1.5
    number = 541
    for pose in POSES:
        write_dng(folder / f"{board_name.format(number)}.DNG", photograph(rng, 2500 * board(*pose)))
        number += 1
    for _ in range(2):
        write_dng(folder / f"{board_name.format(number)}.DNG", photograph(rng, 400 + 1200 * u))
        number += 1
    for _ in range(4):
        write_dng(folder / f"IMG_{number:04d}.DNG", photograph(rng, box))
        number += 1
    for _ in range(4):
        write_dng(folder / f"{dark_name.format(number)}.DNG", photograph(rng, 0 * box))
        number += 1
    nm = np.arange(400, 701, 10)
    curves = np.exp(-(((nm[:, None] - [600, 540, 460]) / [50, 50, 40]) ** 2))
    rows = "\n".join(f"{x},{r},{g},{b}" for x, (r, g, b) in zip(nm, curves, strict=True))
    (folder / "channels.csv").write_text(f"wavelength_nm,r,g,b\n{rows}\n")
    (folder / "lamp.csv").write_text("wavelength_nm,radiance\n400,1\n700,3\n")
    points = rng.uniform((0, 0, 0), (550, 550, 560), (20, 3))
    image = (SIDE - 1) / 2 - FOCAL_PX * (points - POSITION_MM)[:, :2] / (points - POSITION_MM)[:, 2:]
    image += 0.2 * rng.standard_normal(image.shape)
    table = enumerate(np.c_[points, image])
    rows = "\n".join(f"p{k},{','.join(f'{value:.2f}' for value in row)}" for k, row in table)
    (folder / "points.csv").write_text(f"id,x_mm,y_mm,z_mm,u_px,v_px\n{rows}\n")
    return folder


def test_from_the_names_of_the_files_to_the_camera(tmp_path):
    """Only what no file says is asked for: what is printed on the board, and the scene."""
    first = write_first_manifest(evening(tmp_path))
    assert first.tables == {"band": 3, "dark": 1, "target": 1} and not first.left_out
    assert {key.key for key in first.missing if key.required} == {"kind", "rows", "columns", "pitch_mm"}
    optional = [key.key for key in first.missing if not key.required and key.key]
    assert optional[0] == "scene"
    assert not {"image_distance_mm", "relative_uncertainty"} & {*optional}
    (tmp_path / "capture.toml").unlink()
    values = {"kind": "chessboard", "rows": str(ROWS), "columns": str(COLUMNS), "pitch_mm": str(PITCH_MM)}
    where = next(key.where for key in first.missing if key.required)
    write_first_manifest(tmp_path, [ManifestEntry(where, key, value) for key, value in values.items()])
    result = calibrate_capture(load_capture(tmp_path))
    assert not result.suspicions
    (note,) = [note for note in result.notes if "target not used" in note]
    assert note.startswith("target not used: board-IMG_0546.DNG, board-IMG_0547.DNG: found no chessboard")
    assert abs(result.noise.gain_e_per_dn - GAIN) < 4 * result.noise.gain_sigma
    camera, sigma = result.camera, np.sqrt(np.diag(result.camera.covariance))
    truth = [*POSITION_MM, FOCAL_PX]
    fitted = [*camera.position_mm, camera.focal_length_px]
    assert np.all(np.abs(np.subtract(fitted, truth)) < 4 * sigma[[0, 1, 2, 6]])


def test_boards_and_covered_lenses_under_the_names_of_the_camera_are_explained(tmp_path):
    """What the names do not say is asked for; a person who goes on all the same gets one suspicion."""
    first = write_first_manifest(evening(tmp_path, "IMG_{:04d}", "IMG_{:04d}"))
    assert [file.file for file in first.left_out] == [f"IMG_{number:04d}.DNG" for number in range(552, 556)]
    assert all("name it 'dark-...'" in file.why for file in first.left_out)
    notes = " ".join(key.why for key in first.missing if not key.key)
    assert "IMG_0541 to IMG_0548 differ by a number alone" in notes and "name them 'board-...'" in notes
    capture = load_capture(tmp_path)
    stacks = read_stacks(capture, {band: band[-1] for band in capture.band_ids})
    dark = read_darks(capture)
    (suspected,) = check_same_view(capture, stacks, dark, measure_noise(capture, dark))
    assert "show different pictures" in suspected.what and "[[target]]" in suspected.what
    assert suspected.where.startswith("IMG_0541-R, ")


@pytest.mark.parametrize(
    ("black", "expected"), [(64, "the files' black level is subtracted"), (0, "a dark level of 0")]
)
def test_without_darks_the_black_level_of_the_files_counts(tmp_path, black, expected):
    light = np.full((32, 48), 900.0)
    for number in range(2):
        write_dng(tmp_path / f"IMG_{number:04d}.DNG", photograph(np.random.default_rng(number), light), black=black)
    notes = {key.where: key.why for key in write_first_manifest(tmp_path).missing if not key.key}
    assert expected in notes["[[dark]]"]
