"""A bias that drifts through the dark frames is named with its size; steady and trembling ones are not."""

import re

import numpy as np
import pytest
from cboxlab.calibration.quality.frame_checks.darks import check_bias_drift
from cboxlab.calibration.quality.frame_checks.stacks import Stack

READOUT_S = 1.2


def darks(seed, per_minute=0.0, jitter=0.0, tables=4, repeats=4, size=40):
    """Dark frames of several exposures, one table after the other, with a bias that changes by DN a minute."""
    generator, clock, stacks = np.random.default_rng(seed), 0.0, []
    for index in range(tables):
        exposure, frames = 0.5 * 2**index, []
        for _ in range(repeats):
            bias = 100 + per_minute * clock / 60 + jitter * generator.standard_normal()
            counts = bias + 0.5 * exposure + generator.standard_normal((size, size))
            frames.append(np.rint(counts).astype(np.uint16))
            clock += exposure + READOUT_S
        paths = tuple(f"dark-{index}-{k}.tif" for k in range(repeats))
        stacks.append(Stack("dark", f"dark[{index}]", None, exposure, None, paths, np.stack(frames), None))
    return stacks


@pytest.mark.parametrize("per_minute", [4.0, -4.0, 15.0])
def test_a_drift_is_named_with_its_size(per_minute):
    (suspicion,) = check_bias_drift(darks(1, per_minute), READOUT_S)
    drift = float(re.search(r"by ([-+0-9.e]+) \+- ", suspicion.why).group(1))
    assert drift == pytest.approx(per_minute, rel=0.15)
    assert "bias drifts" in suspicion.what


def test_steady_and_trembling_biases_are_sound():
    alarms = [
        list(check_bias_drift(darks(seed, jitter=jitter, tables=tables), READOUT_S))
        for seed in range(50)
        for jitter in (0.0, 0.5)
        for tables in (1, 4)
    ]
    assert len(alarms) == 200 and not any(alarms)


def test_three_exposures_of_two_frames_show_a_large_drift():
    """As many as a series of few bands has; a drift is certain where its size exceeds its scatter 30 times."""
    alarms = [len(list(check_bias_drift(darks(seed, 60.0, tables=3, repeats=2), READOUT_S))) for seed in range(10)]
    assert sum(alarms) >= 8


def test_two_frames_say_nothing_of_a_drift():
    assert not list(check_bias_drift(darks(1, 15.0, tables=1, repeats=2), READOUT_S))
