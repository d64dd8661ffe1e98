"""Form factors in closed form; docs/references.md derives them.

The form factor is the part of the light that leaves a diffuse surface, or a point of it, and arrives at another
surface. The irradiance of a point by a lamp of uniform radiance L is pi L times its form factor to the lamp. Numbers
such as C-11 are those of Howell's catalogue of radiation configuration factors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "disk_above",
    "parallel_squares",
    "perpendicular_rectangles",
    "point_to_polygon",
    "sphere_over",
]


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
    return np.asarray(np.abs((axis @ np.asarray(normal, float) / sine * angle).sum(axis=-1)) / (2 * np.pi))


def parallel_squares(ratio: float) -> float:
    """Form factor between two equal, opposed squares (Howell, C-11).

    Parameters
    ----------
    ratio
        Side over distance, above 0.

    Returns
    -------
    float
        Form factor, 0 to 1.
    """
    x = ratio
    root = np.sqrt(1 + x * x)
    return float(
        2
        / (np.pi * x * x)
        * (
            np.log(np.sqrt((1 + x * x) ** 2 / (1 + 2 * x * x)))
            + 2 * x * root * np.arctan(x / root)
            - 2 * x * np.arctan(x)
        )
    )


def perpendicular_rectangles(h: float, w: float) -> float:
    """Form factor between rectangles at right angles with a common edge (Howell, C-14).

    The edge has length 1.

    Parameters
    ----------
    h
        Height of the receiving rectangle, in lengths of the edge.
    w
        Depth of the emitting rectangle, in lengths of the edge.

    Returns
    -------
    float
        Form factor, 0 to 1.
    """
    s = h * h + w * w
    logs = (
        np.log((1 + w * w) * (1 + h * h) / (1 + s))
        + w * w * np.log(w * w * (1 + s) / ((1 + w * w) * s))
        + h * h * np.log(h * h * (1 + s) / ((1 + h * h) * s))
    )
    arcs = w * np.arctan(1 / w) + h * np.arctan(1 / h) - np.sqrt(s) * np.arctan(1 / np.sqrt(s))
    return float((arcs + logs / 4) / (np.pi * w))


def disk_above(radius: float, distance: float) -> float:
    """Form factor from a point to a parallel disk centred straight above it.

    Parameters
    ----------
    radius
        Radius of the disk.
    distance
        Distance of the disk, in the same unit.

    Returns
    -------
    float
        Form factor, 0 to 1.
    """
    return radius**2 / (radius**2 + distance**2)


def sphere_over(radius: float, distance: float, cosine: float) -> float:
    """Form factor from a point to a sphere entirely above its horizon.

    Parameters
    ----------
    radius
        Radius of the sphere.
    distance
        Distance of its centre, in the same unit.
    cosine
        Cosine of the angle between the point's normal and the direction of the centre.

    Returns
    -------
    float
        Form factor, 0 to 1.
    """
    return (radius / distance) ** 2 * cosine
