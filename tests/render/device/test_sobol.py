"""Sobol' points are those of SciPy, to the last bit."""

import numpy as np
import pytest
from cboxlab.rendering.device import sobol_points
from scipy.stats import qmc


@pytest.mark.parametrize("dimensions", [1, 2, 15, 21])
@pytest.mark.parametrize("log2_points", [0, 1, 11])
def test_points_are_those_of_scipy(dimensions, log2_points):
    reference = qmc.Sobol(dimensions, scramble=False, bits=32).random_base2(log2_points) * 2.0**32
    np.testing.assert_array_equal(sobol_points(dimensions, log2_points), reference)


def test_more_coordinates_than_direction_numbers_are_refused():
    with pytest.raises(IndexError):
        sobol_points(22, 2)
