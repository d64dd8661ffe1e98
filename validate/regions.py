"""Where in the picture: distance from edges of surfaces, interiors against edges.

Everywhere ``surface`` is an integer image [y, x] that indexes the tuple of surface names; the lamp and
whatever lies outside the box are -1. ``pure`` [y, x] is False where a pixel sees more than one surface, or
two faces of one surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["INTERIOR_DISTANCE_PX", "edge_distance_px", "edges", "interiors"]

#: How far inside a surface a pixel has to lie to count as interior.
INTERIOR_DISTANCE_PX = 3.0


def edge_distance_px(surface: ArrayLike, pure: ArrayLike) -> NDArray[np.float64]:
    """Least possible distance (y, x), in px, from a pixel's centre to the nearest edge of what it sees.

    That is the distance to the nearest pixel centre which is impure or sees something else, less the half
    pixel by which the edge may come nearer; 0 for impure pixels, infinite where nothing else is in sight.
    The border of the picture is no edge of a surface.
    """
    surface, pure = np.asarray(surface), np.asarray(pure, bool)
    if surface.ndim != 2 or surface.shape != pure.shape:
        raise ValueError(f"surface and pure need equal (y, x) shapes, got {surface.shape} and {pure.shape}")
    distance = np.zeros(surface.shape)
    for label in np.unique(surface):
        inside = (surface == label) & pure
        if inside.all():
            return np.full(surface.shape, np.inf)
        distance[inside] = distance_transform_edt(inside)[inside] - 0.5
    return distance


def interiors(
    surface: ArrayLike, pure: ArrayLike, distance_px: float = INTERIOR_DISTANCE_PX
) -> NDArray[np.bool_]:
    """Pixels (y, x) of a surface that lie at least ``distance_px`` from any edge of a surface."""
    return (edge_distance_px(surface, pure) >= distance_px) & (np.asarray(surface) >= 0)


def edges(
    surface: ArrayLike, pure: ArrayLike, distance_px: float = INTERIOR_DISTANCE_PX
) -> NDArray[np.bool_]:
    """Pixels (y, x) nearer than ``distance_px`` to an edge, on either side of it."""
    return edge_distance_px(surface, pure) < distance_px
