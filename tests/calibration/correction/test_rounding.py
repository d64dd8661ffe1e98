"""What rounding to whole counts does to the mean of a dark level."""

import numpy as np
import pytest
from cboxlab.calibration.correction.noise import NoiseModel
from scipy.stats import norm

#: Levels between two counts, whole counts.
LEVELS, COUNTS = (np.arange(20000) + 0.5) / 20000, np.arange(-6, 8)


@pytest.mark.parametrize("sigma", [1e-3, 0.1, 0.25, 0.5])
def test_the_rounding_error_is_that_of_rounded_normal_noise(sigma):
    """The expectation of the rounded counts, from the probability of each count: no series, no random numbers."""
    upper, lower = ((COUNTS + half - LEVELS[:, None]) / sigma for half in (0.5, -0.5))
    error = (norm.cdf(upper) - norm.cdf(lower)) @ COUNTS - LEVELS
    noise = NoiseModel(40.0, None, 40.0 * sigma, None)
    assert noise.rounding_error_dn == pytest.approx(np.sqrt(np.mean(error**2)), rel=2e-3, abs=1e-5)
