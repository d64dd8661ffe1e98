"""Sobol' points are those of SciPy."""

import numpy as np
import pytest
from cboxlab.rendering.device import sobol_integers
from scipy.stats import qmc


@pytest.mark.parametrize(("dimensions", "log2_points"), [(1, 0), (2, 7), (6, 11), (12, 9), (16, 10)])
def test_points_are_those_of_scipy(dimensions, log2_points):
    """Bit by bit and in the same order, in all dimensions that have direction numbers."""
    theirs = qmc.Sobol(dimensions, scramble=False, bits=32).random_base2(log2_points) * 2.0**32
    np.testing.assert_array_equal(sobol_integers(dimensions, log2_points), theirs.astype(np.uint32))


def test_more_dimensions_than_direction_numbers():
    """An error, not points that repeat."""
    with pytest.raises(IndexError):
        sobol_integers(17, 4)
