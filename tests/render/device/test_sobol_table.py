"""Sobol' points are those of SciPy, in every dimension."""

import numpy as np
import pytest
from cboxlab.rendering.device import sobol_table
from cboxlab.rendering.device.sobol_table import MOST_DIMENSIONS
from scipy.stats import qmc


@pytest.mark.parametrize("log2_points", [0, 1, 5, 12])
def test_points_are_those_of_scipy(log2_points):
    points = qmc.Sobol(MOST_DIMENSIONS, scramble=False, bits=32).random_base2(log2_points)
    assert np.array_equal(sobol_table(MOST_DIMENSIONS, log2_points), (points * 2.0**32).astype(np.uint32))


def test_each_coordinate_is_stratified():
    points = sobol_table(MOST_DIMENSIONS, 10)
    assert np.array_equal(np.sort(points >> 22, axis=0), np.broadcast_to(np.arange(1024)[:, None], points.shape))
