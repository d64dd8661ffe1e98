"""Large pictures reduced: sums, noise, positions, labels and the sensor that the manifest then describes."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture, scatters
from cboxlab.calibration.capture import reduction as module
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.correction.block_sampling import variance_by_edges
from cboxlab.calibration.geometry import capture_points
from cboxlab.calibration.quality.points import check_points
from cboxlab.calibration.radiometry.sensor_equation import nominal_constant
from cboxlab.calibration.result import calibrate_capture
from cboxlab.calibration.result.write import calibration_record
from cboxlab.scenes import cornell_camera
from cboxlab.utils.errors import InputError
from PIL import Image

GAIN, READ_NOISE_E, BIAS_DN = 2.0, 5.0, 40.0


def written(folder, camera_keys="", tables="", shape=(120, 160), mean_dn=600.0, repeats=4, seed=1):
    """A capture of a ramp of light: repeats of one band and of darks, Poisson and read noise."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    light = mean_dn * GAIN * np.linspace(0.2, 1.8, shape[1]) * np.ones((shape[0], 1))
    for kind, electrons in (("scene", light), ("flat", light), ("dark", np.zeros(shape))):
        for number in range(repeats):
            collected = rng.poisson(electrons) + READ_NOISE_E * rng.standard_normal(shape)
            counts = np.clip(np.rint(collected / GAIN + BIAS_DN), 0, 4095).astype(np.uint16)
            tifffile.imwrite(folder / f"{kind}-{number}.tif", counts)
    names = {kind: [f"{kind}-{i}.tif" for i in range(repeats)] for kind in ("scene", "flat", "dark")}
    (folder / "capture.toml").write_text(
        f"""format = "capture/1"
[camera]
width_px = {shape[1]}
height_px = {shape[0]}
bit_depth = 12
pixel_pitch_um = 5.0
read_noise_e = {READ_NOISE_E}
gain_e_per_dn = {GAIN}
{camera_keys}
[[band]]
id = "f550"
exposure_s = 1.0
frames = {names["scene"]}
[[dark]]
exposure_s = 1.0
frames = {names["dark"]}
[[flat]]
band = "f550"
exposure_s = 1.0
frames = {names["flat"]}
{tables}
"""
    )
    return load_capture(folder)


def test_a_sum_is_the_count_of_a_larger_pixel(tmp_path):
    """Sums of 4 x 4 in a window; the noise of repeats gives the gain of one pixel and four times its read noise.

    The gain from photon transfer agrees to 5 of its standard deviations; rounding adds to the read noise.
    """
    capture = written(tmp_path, "binning = 4\nwindow_px = [8, 4, 620, 460]", shape=(480, 640))
    camera = capture.manifest.camera
    assert capture.shape == (115, 155) and (camera.pixel_pitch_um, camera.bit_depth) == (20.0, 16)
    stored = tifffile.imread(tmp_path / "scene-1.tif").astype(int)
    assert capture.frame("scene-1.tif")[2, 3] == stored[4 + 8 : 4 + 12, 8 + 12 : 8 + 16].sum()
    assert capture.frames(capture.manifest.band[0]).shape == (4, 115, 155)
    noise = measure_noise(capture, read_darks(capture))
    assert noise.gain_e_per_dn == pytest.approx(GAIN, abs=5 * noise.gain_sigma) and noise.gain_sigma < 0.1
    expected = 4 * np.hypot(READ_NOISE_E, GAIN / np.sqrt(12))
    assert noise.read_noise_e == pytest.approx(expected, abs=5 * noise.read_noise_sigma)
    unbinned = written(tmp_path / "whole")
    assert unbinned.reduction is None and unbinned.frame("scene-1.tif").dtype == np.uint16


def test_one_saturated_pixel_saturates_its_block(tmp_path):
    capture = written(tmp_path, "binning = 3")
    frame = tifffile.imread(tmp_path / "scene-0.tif")
    frame[7, 10] = 4095
    tifffile.imwrite(tmp_path / "scene-0.tif", frame)
    counts = load_capture(tmp_path).frame("scene-0.tif")
    assert counts[2, 3] == capture.full_scale_dn == 2**16 - 1
    assert np.count_nonzero(counts == capture.full_scale_dn) == 1


def survey(camera, path):
    world = np.random.default_rng(3).uniform(0, 550, (40, 3))
    image = camera.project(world)
    rows = [f"p{i},{x},{y},{z},{u},{v}" for i, ((x, y, z), (u, v)) in enumerate(zip(world, image, strict=True))]
    path.write_text("\n".join(["id,x_mm,y_mm,z_mm,u_px,v_px", *rows]))


GEOMETRY = '[geometry]\npoints = "points.csv"\npoint_sigma_px = 0.3\n'


def test_the_camera_of_the_blocks_sees_what_the_camera_of_the_pixels_sees(tmp_path):
    """Points at the corners of a block are half a block from its centre; focal length and sigma scale with it."""
    unbinned_camera = cornell_camera(180)
    survey(unbinned_camera, tmp_path / "points.csv")
    tables = GEOMETRY + f"[lens]\nfx_px = {unbinned_camera.focal_length_px}\nfocal_length_mm = 1.26\n"
    capture = written(tmp_path, "binning = 3\nwindow_px = [12, 9, 150, 162]", tables, shape=(180, 180), repeats=2)
    calibration = calibrate_capture(capture)
    camera = calibration.camera
    assert camera.focal_length_px == pytest.approx(unbinned_camera.focal_length_px / 3)
    point = np.array([[200.0, 300.0, 100.0]])
    expected = (unbinned_camera.project(point) - [12, 9] + 0.5) / 3 - 0.5
    assert camera.project(point) == pytest.approx(expected, abs=1e-4)
    assert calibration.camera_fit.point_sigma_px == pytest.approx(0.1)
    assert capture_points(capture).image_px.shape == (40, 2)
    assert any("as sums of 3 x 3 pixels" in note for note in calibration.notes)
    record = calibration_record(calibration)
    assert (record["reduction"]["side_px"], record["reduction"]["u0_px"]) == (3, 12)
    assert nominal_constant(capture) == pytest.approx(
        9 * nominal_constant(written(tmp_path / "w", "", tables="[lens]\nfocal_length_mm = 1.26"))
    )


def test_large_frames_are_reduced_to_the_box_and_small_ones_are_not(tmp_path, monkeypatch):
    """The window is the points' with half their extent around them; the sides of blocks give 20 to 40 across."""
    monkeypatch.setattr(module, "_ACROSS", 20)
    camera = cornell_camera(180)
    survey(camera, tmp_path / "points.csv")
    assert written(tmp_path, "", GEOMETRY, shape=(180, 180), repeats=1).reduction is None
    monkeypatch.setattr(module, "_LARGEST_FRAME", 20_000)
    capture = written(tmp_path, "", GEOMETRY, shape=(180, 180), repeats=1)
    extent = np.ptp(capture_points(capture).image_px, axis=0).max()
    assert 20 <= extent <= 40 and capture.reduction.side_px > 1
    assert written(tmp_path, "binning = 1", GEOMETRY, shape=(180, 180), repeats=1).reduction is None
    behind = written(tmp_path, "", GEOMETRY + '[mosaic]\npattern = "RGGB"\n', shape=(180, 180), repeats=1)
    part = behind.reduction
    assert (part.side_px, part.step_px, part.u0_px % 2, part.v0_px % 2) == (5, 2, 0, 0)


CHANNELS = """[mosaic]
pattern = "{}"
"""


@pytest.mark.parametrize(
    ("pattern", "sides"),
    [("GBRG", (5, 9)), ("RGBW GBWR BWRG WRGB", (9, 17)), ("GBGGRG RGRBGB GBGGRG GRGGBG BGBRGR GRGGBG", (13,))],
)
def test_sums_behind_a_mosaic_keep_its_pattern_and_the_middle_of_a_block(pattern, sides, tmp_path):
    """Every sum is over pixels of its block's channel, whose mean position is the middle of the block."""
    tables = CHANNELS.format(pattern)
    rows = pattern.split() if " " in pattern else [pattern[:2], pattern[2:]]
    cell = np.array([[ord(letter) for letter in row] for row in rows])
    shape = (120, 160)
    letter = np.tile(cell, np.ceil(np.array(shape) / cell.shape).astype(int))[: shape[0], : shape[1]]
    for side in sides:
        capture = written(tmp_path / str(side), f"binning = {side}", tables, repeats=1)
        part = capture.reduction
        count = part.summed**2
        sums = part.counts(letter.astype(np.uint16))
        np.testing.assert_array_equal(sums, count * letter[: sums.shape[0], : sums.shape[1]])
        middles = part.counts(np.tile(np.arange(shape[1], dtype=np.uint16), (shape[0], 1)))[0] / count
        np.testing.assert_allclose(middles, side * np.arange(part.width) + (side - 1) / 2)


def test_edges_add_the_error_of_a_sum_to_its_variance(tmp_path):
    """Sums differ across edges from those of whole blocks by the stated variance, and elsewhere by noise.

    The picture is a bright disk, so that edges have all angles.
    """
    capture = written(tmp_path, "binning = 5", CHANNELS.format("RGGB"), repeats=1, shape=(400, 400))
    part, fine = capture.reduction, 4
    position = (np.arange(400 * fine) + 0.5) / fine - 0.5
    disk = np.add.outer((position - 197) ** 2, (position - 203) ** 2) < 150**2
    light = 200.0 + 1800.0 * disk.reshape(400, fine, 400, fine).mean(axis=(1, 3))
    counts = np.random.default_rng(1).poisson(light).astype(np.uint16)
    sums, spread = part.counts(counts), part.spread(counts)
    variance = variance_by_edges(part, spread, sums / part.summed**2, 1)  # electrons are counted one by one
    block_means = light.reshape(80, 5, 80, 5).mean(axis=(1, 3)) * part.summed**2
    edge = np.ptp(light.reshape(80, 5, 80, 5).transpose(0, 2, 1, 3).reshape(80, 80, -1), axis=-1) > 0
    assert variance[~edge].mean() < 0.02 * block_means[~edge].mean()
    squares = (sums - block_means) ** 2
    assert np.mean(squares[~edge] / block_means[~edge]) == pytest.approx(1.0, abs=0.06)
    assert np.mean(squares[edge] / (block_means + variance)[edge]) == pytest.approx(1.0, abs=0.2)
    assert squares[edge].sum() > 20 * block_means[edge].sum()


@pytest.mark.parametrize(("pattern", "side"), [("RGGB", 9), ("GGRGGB GGBGGR BRGBRG GGBGGR GGRGGB RBGBRG", 25)])
def test_edges_of_all_angles_have_their_variance(pattern, side, tmp_path):
    """Upright edges err six times as much for their scatter as slanted ones; both have a chi-square of about 1."""
    part = written(tmp_path, f"binning = {side}", CHANNELS.format(pattern), repeats=1).reduction
    rng, fine = np.random.default_rng(5), 4
    position = (np.arange(side * fine) + 0.5) / fine - side / 2
    for low, high in ((0.0, 0.05), (0.5, 0.8)):
        chi2 = []
        for angle, offset in zip(rng.uniform(low, high, 400), rng.uniform(-side, side, 400) / 2**0.5, strict=True):
            bright = np.add.outer(np.sin(angle) * position, np.cos(angle) * position) > offset
            light = 400 + 40_000 * bright.reshape(side, fine, side, fine).mean(axis=(1, 3))
            counts = rng.poisson(light)[:: part.step_px, :: part.step_px]
            spread, noise = scatters(counts[None, :, None]), counts.mean(keepdims=True)
            variance = variance_by_edges(part, spread, noise, 1)[0, 0] / part.summed**4 + counts.mean() / counts.size
            chi2.append((counts.mean() - light.mean()) ** 2 / variance)
        assert np.mean(chi2) == pytest.approx(1.0, abs=0.35), low


def test_noise_in_a_scatter_is_no_edge(tmp_path):
    """The variance of an edge is in proportion to the scatter beyond noise: 49 of 99 for 50 and 100 times the noise."""
    part = written(tmp_path, "binning = 5", CHANNELS.format("RGGB"), repeats=1).reduction
    noise = np.ones((1, 1))
    half, double = (variance_by_edges(part, np.full((2, 1, 1), times), noise, 1) for times in (50.0, 100.0))
    np.testing.assert_allclose(half / double, 49 / 99)


def test_weak_steps_count_and_gradients_do_not(tmp_path):
    """A slanted step of 20 %, six times the noise of a pixel, on a gradient of 0.2 % a pixel, curved across it."""
    part = written(tmp_path, "binning = 5", CHANNELS.format("RGGB"), repeats=1, shape=(400, 400)).reduction
    fine = 4
    position = (np.arange(400 * fine) + 0.5) / fine - 0.5
    bright = np.add.outer(0.2 * position, position) > 240
    curved = 1 + np.sin(np.arange(400) / 40) / 2
    light = (
        800
        * curved[:, None]
        * (1 + 0.002 * np.arange(400))
        * (1 + 0.2 * bright.reshape(400, fine, 400, fine).mean(axis=(1, 3)))
    )
    counts = np.random.default_rng(2).poisson(light).astype(np.uint16)
    sums = part.counts(counts)
    means = light.reshape(80, 5, 80, 5).mean(axis=(1, 3)) * part.summed**2
    variance = variance_by_edges(part, part.spread(counts), means / part.summed**2, 1)
    share = bright.reshape(80, 5 * fine, 80, 5 * fine).mean(axis=(1, 3))
    edge = (share > 0) & (share < 1)
    chi2 = (sums - means) ** 2 / (means + variance)
    assert variance[~edge].mean() < 0.03 * means[~edge].mean()
    assert np.mean(chi2[edge]) == pytest.approx(1.0, abs=0.35)
    assert np.mean(chi2[~edge]) == pytest.approx(1.0, abs=0.07)
    assert np.mean(variance[~edge] > 0) < 0.06


def test_the_constant_counts_the_area_that_is_summed(tmp_path):
    """Nine pixels of a block of 25 collect nine times the light of one; the read noise is three times as large."""
    lens = "[lens]\nfocal_length_mm = 1.26\n"
    single = written(tmp_path / "1", "binning = 1", CHANNELS.format("RGGB") + lens, repeats=1)
    nine = written(tmp_path / "5", "binning = 5", CHANNELS.format("RGGB") + lens, repeats=1)
    assert nominal_constant(nine) == pytest.approx(9 * nominal_constant(single))
    camera = nine.manifest.camera
    assert (camera.pixel_pitch_um, camera.read_noise_e) == (25.0, 3 * READ_NOISE_E)


def test_a_label_is_that_of_whole_blocks(tmp_path):
    labels = np.zeros((120, 160), np.uint8)
    labels[10:50, 20:60] = 7
    Image.fromarray(labels).save(tmp_path / "labels.png")
    (tmp_path / "names.csv").write_text("label,name,column\n7,grey,\n")
    capture = written(tmp_path, "binning = 4", '[labels]\nimage = "labels.png"\nnames = "names.csv"\n', repeats=1)
    expected = np.zeros((30, 40), np.uint8)
    expected[3:12, 5:15] = 7
    np.testing.assert_array_equal(capture.labels(), expected)
    assert not capture.excluded_pixels().any()
    (tmp_path / "names.csv").write_text("label,name,column\n7,excluded,\n")
    expected[2:13, 5:15] = 7  # rows 8 to 51: a block with one such pixel is excluded
    np.testing.assert_array_equal(capture.excluded_pixels(), expected == 7)


@pytest.mark.parametrize(
    ("keys", "tables", "message"),
    [
        ("binning = 0", "", "camera.binning"),
        ("binning = 121", "", "found 121; expected at most 120"),
        ("window_px = [0, 0, 161, 10]", "", "within 160 x 120 px"),
        ("window_px = [0, 0, 10]", "", "camera.window_px"),
        ("binning = 2", '[mosaic]\npattern = "RGGB"', "expected 1, 5, 9, 13 and so on"),
    ],
)
def test_wrong_values_are_named(keys, tables, message, tmp_path):
    with pytest.raises(InputError, match=message):
        written(tmp_path, keys, tables, repeats=1)


def test_a_window_leaves_points_outside_without_a_suspicion(tmp_path):
    """Twelve of forty points are in the window; points beyond the stored frame are those of another picture."""
    camera = cornell_camera(180)
    survey(camera, tmp_path / "points.csv")
    small = written(tmp_path, "window_px = [60, 60, 60, 60]", GEOMETRY, shape=(180, 180), repeats=1)
    inside = ((capture_points(small).image_px >= 0) & (capture_points(small).image_px < 60)).all(axis=1)
    assert 4 < np.count_nonzero(inside) < 30 and not list(check_points(small, None))
    (other := tmp_path / "other").mkdir()
    survey(cornell_camera(400), other / "points.csv")
    wrong = written(other, "window_px = [60, 60, 60, 60]", GEOMETRY, shape=(180, 180), repeats=1)
    assert any("another picture" in s.what for s in check_points(wrong, None))
