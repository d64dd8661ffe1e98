"""A lamp that warms up is named with its size; steady, drifting and trembling ones are not."""

import re

import numpy as np
import pytest
from cboxlab.calibration.quality.frame_checks.stacks import Stack
from cboxlab.calibration.quality.frame_checks.warm_up import check_warm_up

READOUT_S, BANDS, EXPOSURE_S, CHANGE_S = 1.2, 7, 4.0, 20.0


class NoDark:
    def at(self, _):
        return np.zeros((64, 64))


def series(seed, power, flicker=0.0, repeats=2, bands=BANDS, brackets=0):
    """Repeats of bands of a lamp of power(minutes), with shot noise; the last ones are brackets."""
    generator, stacks = np.random.default_rng(seed), []
    for band in range(bands):
        start, frames = band * (repeats * (EXPOSURE_S + READOUT_S) + CHANGE_S), []
        for repeat in range(repeats):
            minutes = (start + repeat * (EXPOSURE_S + READOUT_S) + EXPOSURE_S / 2) / 60
            light = 1500 * power(minutes) * (1 + flicker * generator.standard_normal())
            frames.append((generator.poisson(12 * light, (64, 64)) / 12).round().astype(np.uint16))
        paths = tuple(f"{band}-{k}.tif" for k in range(repeats))
        kind = "bracket" if band >= bands - brackets else "band"
        stacks.append(Stack(kind, f"band[{band}]", str(band), EXPOSURE_S, start, paths, np.stack(frames), None))
    return stacks


@pytest.mark.parametrize(("bands", "repeats", "brackets"), [(5, 2, 3), (7, 2, 0), (7, 4, 0), (1, 30, 0)])
def test_a_lamp_that_warms_up_is_named_with_its_size(bands, repeats, brackets):
    """A colour camera may take many repeats of one band, which has all its channels."""
    stacks = series(1, lambda m: 1 - 0.1 * np.exp(-m / 0.8), repeats=repeats, bands=bands, brackets=brackets)
    (suspicion,) = check_warm_up(stacks, NoDark(), 4095, READOUT_S)
    change = float(re.search(r"changes by ([-+0-9.]+)%", suspicion.why).group(1))
    assert change == pytest.approx(9.3, abs=1.5) and "warmed up" in suspicion.what


def test_sound_lamps_and_straight_drifts_raise_nothing():
    powers = (lambda m: 1.0, lambda m: 1 + 0.02 * m)
    alarms = [
        list(check_warm_up(series(seed, power, flicker), NoDark(), 4095, READOUT_S))
        for seed in range(30)
        for power in powers
        for flicker in (0.0, 0.003)
    ]
    assert len(alarms) == 120 and not any(alarms)
