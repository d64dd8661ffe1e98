"""Distance of pixels from the edges of the surfaces that they see."""

import numpy as np
from cboxlab.validation.compare.regions import edge_distance_px


def test_regions_of_a_half_plane():
    """An edge between columns 9 and 10: centres lie 0.5, 1.5, ... px from it."""
    surface = np.repeat([[0] * 10 + [1] * 10], 20, axis=0)
    single_surface = np.ones(surface.shape, bool)
    np.testing.assert_array_equal(
        edge_distance_px(surface, single_surface)[5, 6:14], [3.5, 2.5, 1.5, 0.5, 0.5, 1.5, 2.5, 3.5]
    )
    single_surface[:, 9] = False
    assert edge_distance_px(surface, single_surface)[5, 9] == 0
    assert np.isinf(edge_distance_px(np.zeros((4, 4), int), np.ones((4, 4), bool))).all()
