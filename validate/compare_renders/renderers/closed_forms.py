"""Form factors in closed form; docs/references.md derives them.

The form factor is the part of the light that leaves a diffuse surface, or a point of it, and arrives at another
surface. The irradiance of a point by a lamp of uniform radiance L is pi L times its form factor to the lamp. Numbers
such as C-11 are those of Howell's catalogue of radiation configuration factors.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "disk_above",
    "parallel_squares",
    "perpendicular_rectangles",
    "sphere_over",
]


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
