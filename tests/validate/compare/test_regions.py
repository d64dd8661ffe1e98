"""Distance of pixels from the edges of the surfaces that they see."""

import numpy as np
from cboxlab.validation.compare.regions import edge_distance_px, edges, interiors


def test_regions_of_a_half_plane():
    """An edge between columns 9 and 10: centres lie 0.5, 1.5, ... px from it; three columns are edges."""
    surface = np.repeat([[0] * 10 + [1] * 10], 20, axis=0)
    single_surface = np.ones(surface.shape, bool)
    np.testing.assert_array_equal(
        edge_distance_px(surface, single_surface)[5, 6:14], [3.5, 2.5, 1.5, 0.5, 0.5, 1.5, 2.5, 3.5]
    )
    assert interiors(surface, single_surface)[5].tolist() == [True] * 7 + [False] * 6 + [True] * 7
    assert (edges(surface, single_surface) == ~interiors(surface, single_surface)).all()
    single_surface[:, 9] = False
    assert edge_distance_px(surface, single_surface)[5, 9] == 0
    assert np.isinf(edge_distance_px(np.zeros((4, 4), int), np.ones((4, 4), bool))).all()
    assert not interiors(np.full((9, 9), -1), np.ones((9, 9), bool)).any()
