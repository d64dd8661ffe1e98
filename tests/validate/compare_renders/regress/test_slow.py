"""Slow changes over the picture: the probability by the waves next to them."""

import numpy as np
from cboxlab.validation.compare_renders.regress.patterns.slow import _by_waves

HALVES = np.linspace(2.2, 16, 200)


def test_equal_powers_are_rarely_called_slow_whatever_their_unit():
    """1,000 draws of white noise: at most 5 % + 3 sigma are below 0.05, in any unit; twenty times the power is seen."""
    rng = np.random.default_rng(4)
    draws = [(rng.chisquare(6) / 6, rng.chisquare(1, HALVES.size)) for _ in range(1000)]
    small = [np.array([_by_waves(unit * slow, 6, unit * power, HALVES) for slow, power in draws]) for unit in (1, 1e-8)]
    np.testing.assert_allclose(small[0], small[1], rtol=1e-6)
    assert 0.02 < np.mean(small[0] < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 1000)
    assert max(_by_waves(20 * slow + 20, 6, power, HALVES) for slow, power in draws) < 1e-3
