"""Form factor from points to a polygon, in double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["point_to_polygon"]


def point_to_polygon(points: ArrayLike, normal: ArrayLike, corners: ArrayLike) -> NDArray[np.float64]:
    """Form factor from points to a polygon (Lambert's formula).

    F = |sum over edges of n . e_i angle_i| / (2 pi), where e_i is the unit normal of the plane through the point and
    edge i, and angle_i the angle under which the point sees the edge.

    Parameters
    ----------
    points
        (..., 3) points.
    normal
        (3,) unit normal of all points.
    corners
        (n, 3) corners of a flat polygon that lies entirely above the points' horizon.

    Returns
    -------
    NDArray
        (...) form factors, 0 to 1.
    """
    offset = np.asarray(corners, float) - np.asarray(points, float)[..., None, :]
    following = np.roll(offset, -1, axis=-2)
    axis = np.cross(offset, following)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (offset * following).sum(axis=-1))
    # a point on the line of an edge sees it under no angle
    height = axis @ np.asarray(normal, float) / np.maximum(sine, 1e-300)
    return np.asarray(np.abs((height * angle).sum(axis=-1)) / (2 * np.pi))
