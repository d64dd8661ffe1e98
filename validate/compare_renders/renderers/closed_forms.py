"""Form factors in closed form; docs/references.md derives them.

A form factor is the part of what a diffuse surface (or a point of it) sends out that arrives at another one. A point's
irradiance from a lamp of uniform radiance L is pi L times the point's form factor to the lamp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "corner_to_rectangle",
    "disk_above",
    "parallel_squares",
    "perpendicular_rectangles",
    "point_to_polygon",
    "sphere_over",
]


def point_to_polygon(points: ArrayLike, normal: ArrayLike, corners: ArrayLike) -> NDArray[np.float64]:
    """(...,) from points (..., 3) with one normal (3,) to a polygon (n, 3) wholly above their horizon (Lambert)."""
    offset = np.asarray(corners, float) - np.asarray(points, float)[..., None, :]
    following = np.roll(offset, -1, axis=-2)
    axis = np.cross(offset, following)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (offset * following).sum(axis=-1))
    return np.asarray(np.abs((axis @ np.asarray(normal, float) / sine * angle).sum(axis=-1)) / (2 * np.pi))


def parallel_squares(ratio: float) -> float:
    """Between equal, opposed squares, ratio = side / distance (Howell's catalogue, C-11)."""
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
    """From a rectangle of depth w to one of height h, at right angles, common edge 1 (Howell, C-14)."""
    s = h * h + w * w
    logs = (
        np.log((1 + w * w) * (1 + h * h) / (1 + s))
        + w * w * np.log(w * w * (1 + s) / ((1 + w * w) * s))
        + h * h * np.log(h * h * (1 + s) / ((1 + h * h) * s))
    )
    arcs = w * np.arctan(1 / w) + h * np.arctan(1 / h) - np.sqrt(s) * np.arctan(1 / np.sqrt(s))
    return float((arcs + logs / 4) / (np.pi * w))


def corner_to_rectangle(a: float, b: float, c: float) -> float:
    """From a point to a parallel rectangle a x b at distance c, one corner straight above (Howell, B-3)."""
    x, y = a / c, b / c
    return float(
        (
            x / np.sqrt(1 + x * x) * np.arctan(y / np.sqrt(1 + x * x))
            + y / np.sqrt(1 + y * y) * np.arctan(x / np.sqrt(1 + y * y))
        )
        / (2 * np.pi)
    )


def disk_above(radius: float, distance: float) -> float:
    """From a point to a parallel disk centred straight above it."""
    return radius**2 / (radius**2 + distance**2)


def sphere_over(radius: float, distance: float, cosine: float) -> float:
    """From a point to a sphere wholly above its horizon. cosine : of its centre's angle from the normal."""
    return (radius / distance) ** 2 * cosine
