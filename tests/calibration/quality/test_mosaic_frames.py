"""One frame in several bands behind a mosaic, and frames that are copied all the same."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.quality.content import check_frame_content
from cboxlab.calibration.quality.frame_checks.dark_light import check_light_in_darks
from cboxlab.calibration.quality.frame_checks.repeats import _check_lines, check_independence
from cboxlab.calibration.quality.frame_checks.schedule import check_schedule
from cboxlab.calibration.quality.frame_checks.stacks import Stack

FRAME = np.random.default_rng(2).integers(100, 4000, (1, 12, 12)).astype(np.uint16)


def stack(band, channel, path="frames/0.tif", start_s=0.0):
    return Stack("band", f"band ({band})", band, 1.0, start_s, (path,), FRAME, None, channel)


@pytest.mark.parametrize(
    ("second", "suspected"),
    [
        (stack("g", "G"), False),
        (stack("g", "R"), True),
        (stack("g", "G", "frames/copy.tif"), True),
        (stack("g", None), True),
    ],
)
def test_the_same_content_in_two_bands(second, suspected):
    stacks = [stack("r", "R"), second, stack("b", "B")]
    assert bool(list(check_frame_content(stacks))) is suspected


def test_channels_of_a_frame_begin_at_the_same_time():
    assert not list(check_schedule([stack("r", "R"), stack("g", "G"), stack("b", "B")]))
    assert list(check_schedule([stack("r", "R"), stack("g", "G", "frames/other.tif")]))


@pytest.mark.parametrize("lines", [12, 40])
def test_few_rows_of_a_channel_vary_more_by_chance(lines):
    """The variance of 12 means exceeds 2 by chance once in 50, that of 40 means once in 5700."""
    of_chance = np.random.default_rng(lines).chisquare(lines, (4000, 2)) / lines

    def suspected(rows, columns):
        stack = SimpleNamespace(kind="band", counts=np.zeros((2, lines, lines)))
        return len([*_check_lines([SimpleNamespace(stack=stack, lines=(rows, columns))])])

    assert sum(suspected(*pair) for pair in of_chance) <= 6
    assert suspected(6.0, 1.0) == 1


@pytest.mark.parametrize(("rate_dn_s", "suspected"), [(0.0, False), (1.0, True), (5.0, True)])
def test_light_in_the_darks_of_a_colour_sensor_follows_its_colours(rate_dn_s, suspected):
    """Dark current and the levels of the channels are no light: 30 captures each, read noise 1 DN."""
    rng, side = np.random.default_rng(5), 48
    red, blue = np.zeros((side, side)), np.zeros((side, side))
    red[::2, ::2], blue[1::2, 1::2] = 1, 1
    response, offset = 1 - 0.5 * red - 0.7 * blue, 3 * red - 2 * blue
    flat = (400 + 1500 * response).astype(np.uint16)[None]
    channels = {"R": (0, 0, 2), "G": (0, 1, 2), "B": (1, 1, 2)}
    flats = [Stack("flat", f"flat ({c})", c, 1.0, None, ("flat.tif",), flat, at, c) for c, at in channels.items()]
    for _ in range(30):
        times = np.array([1.0, 8.0])
        noise = rng.standard_normal((2, side, side)) + 0.3 * times[:, None, None] * rng.exponential(1, (side, side))
        level = 400 + offset + noise + rate_dn_s * times[:, None, None] * response
        dark = SimpleNamespace(exposure_s=times, level=level, at=lambda _, first=level[0]: first)
        stacks = [*flats, *(Stack("dark", f"dark ({t:g} s)", None, t, None, ("d",), flat, None) for t in times)]
        suspicions = [*check_light_in_darks(stacks, dark)]
        assert bool(suspicions) is suspected
        if suspicions:
            assert suspicions[0].where == "dark (8 s)" and "colours' sensitivities" in suspicions[0].why
            level_dn = float(re.search(r"it is ([\d.]+) DN at 8 s", suspicions[0].why)[1])
            assert rate_dn_s < 5 or level_dn == pytest.approx(8 * rate_dn_s * response.mean(), rel=0.2)


def of_neighbours(frame):
    """Each pixel replaced by the mean of its neighbours in the row, which have another colour."""
    return (np.roll(frame, 1, 1) + np.roll(frame, -1, 1)) / 2


#: By what was done to the frames, whether it is one mistake of them all.
PROCESSED = {
    "nothing": (lambda frame: frame, False),
    "interpolated between colours": (lambda frame: of_neighbours(of_neighbours(frame).T).T, True),
    "moved by half a pixel along rows": (lambda frame: (frame + np.roll(frame, 1, 1)) / 2, True),
    "cells of four pixels averaged by colour": (
        lambda frame: np.tile(frame.reshape(16, 2, 2, 16, 2, 2).mean((1, 4))[:, None, :, :, None], (1, 2, 1, 1, 2, 1)),
        True,
    ),
}


@pytest.mark.parametrize("case", PROCESSED)
def test_frames_whose_pixels_share_noise_are_named_once(case):
    """Noise of a raw frame is independent even between pixels of different colours: 64 x 64 px, gain 2."""
    process, suspected = PROCESSED[case]
    rng, side = np.random.default_rng(6), 64
    picture = 300 + 900 * np.tile([[0.4, 1.0], [1.0, 0.6]], (side // 2, side // 2))
    repeats = [process(rng.poisson(2 * picture) / 2).reshape(side, side) for _ in range(3)]
    frames = np.rint(np.stack(repeats) + 100).astype(np.uint16)
    at = {"R": (0, 0, 2), "G": (0, 1, 2), "B": (1, 1, 2)}
    stacks = [
        Stack("band", f"band[{k}] ({c})", c, 1.0, None, ("0", "1", "2"), frames, lattice, c)
        for k, (c, lattice) in enumerate(at.items())
    ]
    dark = SimpleNamespace(at=lambda _: np.full((side, side), 100.0), thermal=lambda _: np.zeros((side, side)))
    camera = SimpleNamespace(gain_e_per_dn=2.0, read_noise_e=0.0)
    manifest = SimpleNamespace(camera=camera, mosaic="RGGB")
    capture = SimpleNamespace(manifest=manifest, saturation_dn=4095, cell=(2, 2))
    suspicions, tables = check_independence(capture, stacks, dark, None)
    assert [s.where for s in suspicions] == (["band.frames"] if suspected else [])
    assert tables == ({stack.key for stack in stacks} if suspected else set())
