"""Lines by medians are those of SciPy."""

import numpy as np
import pytest
from cboxlab.utils.robust_line import median_line
from scipy.stats import theilslopes


@pytest.mark.parametrize("repeated", [False, True])
def test_lines_are_those_of_scipy(repeated):
    """With outliers, and with positions that repeat; the same bits."""
    generator = np.random.default_rng(3)
    x = generator.random(21)
    x = np.round(x, 1) if repeated else x
    y = 3 * x - 2 + 0.01 * generator.standard_normal(21)
    y[:4] += 50
    theirs = theilslopes(y, x)
    assert median_line(x, y) == (theirs.slope, theirs.intercept)


def test_points_of_one_position_have_no_slope():
    """No warning either."""
    assert np.isnan(median_line([1.0, 1.0], [2.0, 3.0])).all()
