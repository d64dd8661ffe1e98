"""Part of the lamps that positions in a scene see, in double precision."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes import Scene
from numpy.typing import NDArray

__all__ = ["part_of_lamps"]

#: Points across half a lamp's quad (a triangle): 50 in all of a quad, so that a half shadow has steps of 2 %.
_LAMP_POINTS_ACROSS = 5


def part_of_lamps(scene: Scene, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Part of the lamps' area that positions see.

    Parameters
    ----------
    scene
        Model of the scene.
    positions
        (n, 3) positions, mm, a little off the face on which they lie.

    Returns
    -------
    NDArray
        (n,) parts, 0 to 1, in steps of one of the points on the lamps.
    """
    steps = (np.arange(_LAMP_POINTS_ACROSS) + 0.5) / _LAMP_POINTS_ACROSS
    x, y = (axis.ravel()[:, None] for axis in np.meshgrid(np.sqrt(steps), steps))
    triangles = np.concatenate([lamp.surface.vertices_mm[lamp.surface.faces] for lamp in scene.lamps])
    lamps = np.concatenate([a + x * (1 - y) * (b - a) + x * y * (c - a) for a, b, c in triangles])
    hidden = np.zeros((len(positions), len(lamps)), bool)
    for a, b, c in np.concatenate([surface.vertices_mm[surface.faces] for surface in scene.surfaces]):
        from_a, to_lamps = positions - a, lamps - a
        normal = np.cross(c - a, b - a)
        height, lamp_height = from_a @ normal, to_lamps @ normal
        if max(height.max(), lamp_height.max()) <= 0 or min(height.min(), lamp_height.min()) >= 0:
            continue  # all on one side of the face
        turned = np.cross(from_a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            # determinants of Möller and Trumbore (1997), of every position and every point of the lamps
            slope = lamp_height - height[:, None]
            first, second = np.cross(c - a, from_a) @ to_lamps.T / slope, turned @ to_lamps.T / slope
            distance = (turned @ (c - a))[:, None] / slope
            hidden |= (first >= 0) & (second >= 0) & (first + second <= 1) & (distance > 0) & (distance < 1)
    return np.asarray(1 - hidden.mean(axis=1), np.float64)
