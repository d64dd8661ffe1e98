"""Dead and hot lines of a sensor are named with their places; one-row ceilings and uneven columns are not."""

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_lattice
from cboxlab.calibration.quality.frame_checks.fields import _dead_lines, check_lines
from cboxlab.calibration.quality.frame_checks.stacks import Stack

SIDE, FULL = 48, 4095


class Level:
    def __init__(self, level):
        self.level = level

    def at(self, _):
        return self.level


def frames(seed, pattern, change=lambda light, bias: None):
    """Photographs of a box under a ceiling seen as one bright row, flats and darks; ``change`` spoils the sensor."""
    generator, v = np.random.default_rng(seed), np.mgrid[:SIDE, :SIDE][0] / SIDE
    picture = 600 + 1500 * v
    picture[9], picture[30], picture[:, 20] = 2900, 40, 60
    lattices = [channel_lattice(pattern, letter) for letter in "RGB"] if pattern else [None] * 3
    # columns of sound sensors differ in gain and bias
    gain, bias = 1 + 0.03 * generator.standard_normal(SIDE), 60 + 4 * generator.standard_normal((1, SIDE))

    def exposed(light):
        light, level = light * gain, np.broadcast_to(bias, (SIDE, SIDE)).copy()
        change(light, level)
        counts = generator.poisson(12 * light, (2, SIDE, SIDE)) / 12 + level + generator.normal(0, 1, (2, SIDE, SIDE))
        return np.clip(np.rint(counts), 0, FULL).astype(np.uint16)

    stacks = [Stack("dark", "dark[0]", None, 1.0, None, ("d",), exposed(np.zeros((SIDE, SIDE))), lattices[0])]
    for k, lattice in enumerate(lattices):
        for kind, light in (("band", picture), ("flat", np.full((SIDE, SIDE), 2000.0))):
            counts = exposed(light)
            stacks.append(Stack(kind, f"{kind}[{k}]", str(k), 1.0, 0.0, (f"{kind}{k}",), counts, lattice))
    return stacks, Level(stacks[0].frames.mean(axis=0))


@pytest.mark.parametrize("pattern", ["", "RGGB"])
def test_defective_lines_are_named_with_their_places(pattern):
    def dead(light, bias):
        light[:, [7, 32]] *= 0.01

    def hot(light, bias):
        bias[[11, 12]] += 90

    def stuck(light, bias):
        light[17], bias[17] = 0, 0

    for change, what in ((dead, "dead columns"), (hot, "hot rows"), (stuck, "dead rows")):
        (suspicion,) = check_lines(*frames(1, pattern, change), FULL)
        lines = {"dead columns": "7, 32", "hot rows": "11, 12", "dead rows": "17"}[what]
        assert suspicion.what == f"{what} of the sensor: {lines}"


def test_sound_sensors_have_no_defective_lines():
    """Objects of one row and column, and columns of other gain and bias."""
    assert not [s for seed in range(4) for p in ("", "RGGB") for s in check_lines(*frames(seed, p), FULL)]


def test_a_line_is_dead_over_nearly_all_of_its_length_and_between_bright_ones():
    image = np.full((SIDE, SIDE), 3000.0)
    image[10, :36] = 0  # three quarters: an object
    image[24:], image[35] = 3, 0  # black things between dim ones
    assert _dead_lines(image) == set()
    image[10] = 0
    assert _dead_lines(image) == {10}
