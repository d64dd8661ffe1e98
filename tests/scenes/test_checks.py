"""Triangles without area, each by its longest edge."""

import numpy as np
import pytest
from cboxlab.scenes.checks import SMALLEST_AREA, surface_faults
from cboxlab.scenes.scene import Surface

BIG = [[0, 0, 0], [1e4, 0, 0], [0, 1e4, 0]]


@pytest.mark.parametrize(("height", "faults"), [(3.0, 0), (0.3, 1)])
def test_a_triangle_is_measured_by_its_own_edges(height, faults):
    """A thin triangle next to a large one; its area over the square of its edge decides, not over the other's."""
    base = 1.0
    thin = [[0, 0, 0], [base, 0, 0], [base / 2, height * SMALLEST_AREA * 2 * base, 0]]
    surface = Surface("s", "white", np.array(BIG + thin, float), np.array([[0, 1, 2], [3, 4, 5]]))
    assert len(surface_faults(surface, "s")) == faults
