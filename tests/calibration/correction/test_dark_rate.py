"""Dark current from two similar exposures of rounded counts: the line in time has the true start and slope."""

import numpy as np
import pytest
from cboxlab.calibration.correction.dark import _fit_line

BIAS_DN, READ_DN, TIMES_S, REPEATS = 100.0, 0.83, np.array([2.5, 3.0]), 2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rate", [0.0, 0.25, 0.5, 1.2])
def test_rounded_counts_give_the_true_rate(rate, seed):
    rng = np.random.default_rng(seed)
    bias = BIAS_DN + 0.5 * rng.standard_normal((160, 160))
    levels = (bias + rate * TIMES_S[:, None, None])[:, None]
    frames = np.rint(levels + READ_DN * rng.standard_normal((2, REPEATS, *bias.shape)))
    variance = float(frames.var(axis=1, ddof=1).mean())
    start, slope = _fit_line(TIMES_S, np.full(2, REPEATS), frames.mean(axis=1), variance)
    # of the mean slope and of the mean start, from the noise of a frame
    sigma = np.sqrt(2 * variance / REPEATS / bias.size) / np.ptp(TIMES_S)
    assert slope.mean() == pytest.approx(rate, abs=5 * sigma)
    assert start.mean() == pytest.approx(bias.mean(), abs=5 * sigma * TIMES_S.mean())
