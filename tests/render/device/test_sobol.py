"""Sobol' points are SciPy's, to the last bit."""

import numpy as np
import pytest
from cboxlab.rendering.device.sobol import MOST_DIMENSIONS, sobol_integers
from scipy.stats import qmc


@pytest.mark.parametrize(("dimensions", "log2_points"), [(1, 0), (2, 5), (7, 12), (MOST_DIMENSIONS, 14)])
def test_as_scipy(dimensions, log2_points):
    points = qmc.Sobol(dimensions, scramble=False, bits=32).random_base2(log2_points)
    np.testing.assert_array_equal(sobol_integers(dimensions, log2_points), (points * 2.0**32).astype(np.uint32))
