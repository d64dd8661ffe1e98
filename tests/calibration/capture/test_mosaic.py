"""Mosaics of any repeat and phase: which pixels belong to which channel."""

import numpy as np
import pytest
from cboxlab.calibration.capture.manifest import MosaicTable, channel_letters
from cboxlab.calibration.capture.mosaic import channel_lattice, channel_mask
from cboxlab.calibration.capture.whole_manifest import Manifest
from cboxlab.calibration.correction.defects import dead_pixels
from helpers.files.frame_files import BAYER, XTRANS, shifted
from pydantic import ValidationError

PATTERNS = {
    "Bayer": BAYER,
    "X-Trans": XTRANS,
    "2 x 4": ("RGBG", "GRGB"),
    "3 x 3": ("RGB", "GBR", "BRG"),
}


def written(rows):
    return "".join(rows) if [len(row) for row in rows] == [2, 2] else " ".join(rows)


@pytest.mark.parametrize("rows", PATTERNS.values(), ids=PATTERNS)
@pytest.mark.parametrize(("down", "right"), [(0, 0), (0, 1), (1, 0), (3, 2), (5, 4)])
@pytest.mark.parametrize("shape", [(13, 11), (12, 12), (1, 5)])
def test_every_pixel_has_the_letter_of_its_place(rows, down, right, shape):
    rows = shifted(rows, down, right)
    pattern = MosaicTable(pattern=written(rows)).pattern
    masks = {channel: channel_mask(pattern, shape, channel) for channel in "RGB"}
    for v in range(shape[0]):
        for u in range(shape[1]):
            letter = rows[v % len(rows)][u % len(rows[0])]
            assert {channel for channel in "RGB" if masks[channel][v, u]} == {letter}


@pytest.mark.parametrize(
    ("rows", "channel", "step"),
    [
        (BAYER, "R", 2),
        (BAYER, "G", 2),
        (XTRANS, "G", 3),
        (XTRANS, "R", 6),
        (PATTERNS["3 x 3"], "B", 3),
        (PATTERNS["2 x 4"], "G", 2),
    ],
)
@pytest.mark.parametrize(("down", "right"), [(0, 0), (1, 0), (0, 1), (2, 5)])
def test_the_lattice_of_a_channel(rows, channel, step, down, right):
    pattern = written(shifted(rows, down, right))
    row, column, lattice_letter = channel_lattice(pattern, channel)
    assert lattice_letter == step and row < step and column < step
    assert channel_mask(pattern, (36, 36), channel)[row::step, column::step].all()


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", "GRBG", "BGGR"])
@pytest.mark.parametrize("channel", "RGB")
def test_a_bayer_channel_begins_with_its_first_pixel(pattern, channel):
    assert channel_lattice(pattern, channel) == (*divmod(pattern.index(channel), 2), 2)


@pytest.mark.parametrize("pattern", ["RG1B", "RGG", "GGGG", "GBGGRG RGRBG", "RG GB BR G", "RGGBRGGB", "", "RG  GB"])
def test_what_is_no_repeat_is_refused(pattern):
    with pytest.raises(ValidationError):
        MosaicTable(pattern=pattern)


@pytest.mark.parametrize("pattern", ["RGBW", "CYGM", "RGGX", "WWRG WWGB"])
def test_letters_of_any_alphabet(pattern):
    letters = channel_letters(MosaicTable(pattern=pattern).pattern)
    assert sorted(letters) == sorted(set(pattern.replace(" ", "")))
    masks = [channel_mask(pattern, (9, 7), letter) for letter in letters]
    assert np.all(np.sum(masks, axis=0) == 1)


@pytest.mark.parametrize("rows", PATTERNS.values(), ids=PATTERNS)
def test_numbered_pixels_of_a_channel_in_reading_order(rows):
    pattern = written(rows)
    positions = [(v, u) for v, row in enumerate(rows) for u, letter in enumerate(row) if letter == "G"]
    for number, (v, u) in enumerate(positions, 1):
        mask = channel_mask(pattern, (2 * len(rows), 2 * len(rows[0])), f"G{number}")
        assert mask.sum() == 4 and mask[v, u] and mask[v + len(rows), u + len(rows[0])]
    for wrong in ("G0", f"G{len(positions) + 1}", "g", "GG", "G1x", "", "1"):
        with pytest.raises(ValueError, match="not in the pattern"):
            channel_mask(pattern, (6, 6), wrong)


def test_dead_pixels_are_compared_with_those_of_their_place():
    """The channels differ by a factor of ten: without the repeat every blue pixel would look dead."""
    rng = np.random.default_rng(1)
    response = 1 + 0.01 * rng.standard_normal((72, 72))
    for channel, factor in (("R", 0.3), ("B", 0.1)):
        response[channel_mask(" ".join(XTRANS), response.shape, channel)] *= factor
    response[30, 31] *= 0.5
    assert np.argwhere(dead_pixels(response, (6, 6))).tolist() == [[30, 31]]


CAMERA = {"width_px": 4, "height_px": 4, "pixel_pitch_um": 5.0, "bit_depth": 12}
BAND = {"id": "red", "channel": "R", "frames": ["red.tif"], "exposure_s": 1.0}
COLUMNS = ["camera.csv:r", "camera.csv:g", "camera.csv:b"]


def manifest(camera=(), mosaic=()):
    tables = {"camera": CAMERA | dict(camera), "mosaic": {"pattern": "RGGB"} | dict(mosaic)}
    return Manifest.model_validate({"format": "capture/1", "band": [BAND], **tables})


def test_quantum_efficiencies_may_stand_with_the_mosaic():
    efficiencies = {"quantum_efficiency": COLUMNS}
    assert manifest(mosaic=efficiencies) == manifest(camera=efficiencies) != manifest()


def test_quantum_efficiencies_stand_once():
    efficiencies = {"quantum_efficiency": COLUMNS}
    with pytest.raises(ValidationError, match=r"mosaic.quantum_efficiency\n +Extra inputs"):
        manifest(efficiencies, efficiencies)
