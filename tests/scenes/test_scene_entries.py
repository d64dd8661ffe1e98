"""Patterns of lamps, by their mean."""

import numpy as np
from cboxlab.scenes.scene_entries import LampEntry, lamp_pattern

QUAD = [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]


def test_a_pattern_is_scaled_to_mean_1():
    """The lamp's radiance stays the mean over its face, whatever the numbers of the pattern are."""
    rows = [[1.0, 3.0], [0.0, 12.0]]
    pattern = lamp_pattern(LampEntry(quads_mm=[QUAD], radiance="light", pattern=rows), "lamp")
    np.testing.assert_allclose(pattern, np.array(rows) / 4)
