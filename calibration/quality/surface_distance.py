"""Distance of points from the surfaces of a scene."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes import Scene
from numpy.typing import NDArray

__all__ = ["distance_to_surfaces"]


def distance_to_surfaces(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points to the nearest surface of a scene.

    Parameters
    ----------
    scene
        Its surfaces and lamps count.
    points
        (n, 3) mm.

    Returns
    -------
    NDArray
        (n,) mm.
    """
    nearest = np.full(len(points), np.inf)
    for surface in scene.all_surfaces:
        for face in surface.faces:
            nearest = np.minimum(nearest, _distance_to_triangle(points, surface.vertices_mm[face]))
    return nearest


def _distance_to_triangle(points: NDArray[np.float64], triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance of points (n, 3) to a triangle (3, 3): height above it, or to its edges."""
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    height = (points - a) @ normal
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), bool)
    rim = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.cross(edge, foot - start) @ normal >= -1e-9
        share = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-12), 0, 1)
        rim = np.minimum(rim, np.linalg.norm(points - start - share[:, None] * edge, axis=1))
    return np.where(inside, np.abs(height), rim)
