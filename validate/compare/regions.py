"""Distance of pixels from the edges of the surfaces that they see.

``surface`` is an integer image [y, x] of indices into the surface names; -1 for the lamp and outside the box.
``single_surface`` [y, x] is False where a pixel sees several surfaces, or several faces of one surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["INTERIOR_DISTANCE_PX", "edge_distance_px"]

#: Smallest distance of interior pixels from an edge, px.
INTERIOR_DISTANCE_PX = 3.0


def edge_distance_px(surface: ArrayLike, single_surface: ArrayLike) -> NDArray[np.float64]:
    """Lower bound of the distance from a pixel's centre to the nearest edge of its surface.

    It is the distance to the nearest pixel centre that sees several surfaces or another surface, minus 0.5 px. The
    border of the picture is not an edge.

    Parameters
    ----------
    surface
        (y, x) index of the surface, -1 for the lamp and outside the box.
    single_surface
        (y, x) False where a pixel sees several surfaces or faces.

    Returns
    -------
    NDArray
        (y, x) distance, px; 0 for pixels that see several surfaces, infinite if the picture shows one surface only.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    surface, single_surface = np.asarray(surface), np.asarray(single_surface, bool)
    if surface.ndim != 2 or surface.shape != single_surface.shape:
        shapes = f"{surface.shape} and {single_surface.shape}"
        raise ValueError(f"surface and single_surface need equal (y, x) shapes, got {shapes}")
    distance = np.zeros(surface.shape)
    for label in np.unique(surface):
        inside = (surface == label) & single_surface
        if inside.all():
            return np.full(surface.shape, np.inf)
        distance[inside] = distance_transform_edt(inside)[inside] - 0.5
    return distance
