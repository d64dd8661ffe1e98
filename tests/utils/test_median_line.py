"""A line that a few points far off do not move."""

import numpy as np
import pytest
from cboxlab.utils.median_line import median_line
from scipy.stats import theilslopes


@pytest.mark.parametrize("count", [2, 5, 8, 41])
def test_the_line_is_that_of_scipy(count):
    generator = np.random.default_rng(count)
    x, y = generator.integers(0, 2 * count, count) + np.eye(count)[0], generator.normal(size=count)
    assert median_line(x, y) == theilslopes(y, x)[:2]


def test_points_far_off_do_not_move_the_line():
    x = np.arange(20.0)
    y = np.where(x % 5 == 0, 1e6, 3.0 - 0.25 * x)
    assert median_line(x, y)[0] == pytest.approx(-0.25)
