"""The black level of raw files from the pixels under the sensor's mask."""

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from cboxlab.calibration.frame_readers import frame_header
from helpers.files.frame_files import write_dng

MASKED = 16
BLACK_DN = 128.0


def sensor(seed, scene=1000.0, masked=BLACK_DN):
    """Counts of 64 x 96 pixels in the light and 16 masked columns next to them, read noise 2 DN."""
    generator = np.random.default_rng(seed)
    light = np.tile(np.linspace(0.2, 1.8, 96) * scene, (64, 1))
    counts = np.hstack([np.zeros((64, MASKED)), generator.poisson(light)]) + BLACK_DN
    counts[:, :MASKED] += masked - BLACK_DN
    return np.rint(counts + 2.0 * generator.standard_normal(counts.shape)).astype(np.uint16)


def level(path, image, **keys):
    write_dng(path, image, **keys)
    return frame_header(path).facts.black_level


def test_masked_pixels_give_the_black_level(tmp_path):
    """The mean of 8 x 64 pixels in four channels is known to 0.2 DN."""
    black_level = level(tmp_path / "a.dng", sensor(1), masked_columns=MASKED)
    assert set(black_level) <= {"R", "G", "G2", "B"}
    assert black_level == {channel: pytest.approx(BLACK_DN, abs=0.8) for channel in black_level}


@pytest.mark.parametrize("rows", [("RG", "GB"), ("GB", "RG"), ("BG", "GR"), ("GR", "BG")])
def test_each_channel_has_the_level_of_its_masked_pixels(tmp_path, rows):
    """The second green is the second in reading order, also where it lies in the row of red."""
    letters, offsets = list("".join(rows)), [0, 6, 12, 18]
    letters[max(k for k in range(4) if letters[k] == "G")] = "G2"
    image = sensor(1) + np.tile(np.reshape(offsets, (2, 2)), (32, (96 + MASKED) // 2)).astype(np.uint16)
    black_level = level(tmp_path / "a.dng", image, masked_columns=MASKED, rows=rows)
    expected = {letter: pytest.approx(BLACK_DN + dn, abs=1.0) for letter, dn in zip(letters, offsets, strict=True)}
    assert black_level == expected


@pytest.mark.parametrize(
    ("image", "columns"),
    [
        (sensor(1), 0),
        (sensor(1), 12),
        (sensor(1, masked=1500.0), MASKED),
        (sensor(1)[:, ::-1].copy(), MASKED),
    ],
    ids=["no mask", "too narrow", "brighter than the scene", "a border in the light"],
)
def test_columns_that_are_no_mask_give_none(image, columns, tmp_path):
    assert set(level(tmp_path / "a.dng", image, masked_columns=columns).values()) == {0.0}


def test_a_capture_without_darks_takes_the_mean_over_its_files(tmp_path):
    for number in range(2):
        write_dng(tmp_path / f"f{450 + 100 * number}-0.dng", sensor(number), masked_columns=MASKED)
    write_first_manifest(tmp_path)
    black_level = load_capture(tmp_path).manifest.camera.black_level_dn
    assert all(value == pytest.approx(BLACK_DN, abs=0.6) for value in black_level.values())
