"""What depends on the level of a count is linear between levels."""

import numpy as np
from cboxlab.rendering.fitted_fields import parts_of_levels
from numpy.testing import assert_allclose


def test_counts_by_their_level_are_interpolated_and_keep_the_ends() -> None:
    counts = np.random.default_rng(2).uniform(-50, 1100, 300)
    parts = parts_of_levels(counts, 1000.0)
    knots = np.linspace(0, 1000, parts.shape[0])
    values = np.sin(knots / 90)
    assert_allclose(values @ parts, np.interp(counts, knots, values), atol=1e-12)
