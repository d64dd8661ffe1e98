"""Maps on surfaces of the scene, by place in mm: smooth waves, or values at points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

__all__ = ["PointMap", "SurfaceMap", "WaveMap"]


@dataclass(frozen=True, eq=False)
class WaveMap:
    """A sum of products of cosines on one surface.

    low, extent : (3,) mm of the place where it is defined. waves : (n, 3) half waves along x, y, z. values : (n,).
    spectrum : (band,) by which it is multiplied beside the field's, where surfaces differ in theirs.
    """

    surface: str
    low: NDArray[np.float64]
    extent: NDArray[np.float64]
    waves: NDArray[np.float64]
    values: NDArray[np.float64]
    spectrum: NDArray[np.float64] | None = None

    def at(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) values at positions (n, 3), mm, on the surface."""
        place = (position - self.low) / np.maximum(self.extent, 1e-9)
        phases = np.cos(np.pi * place[:, None, :] * self.waves[None])
        return np.asarray(phases.prod(axis=2) @ self.values)

    def over_patches(self, centre: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        """(p,) means over patches with these centres (p, 3)."""
        return self.at(centre)


@dataclass(frozen=True, eq=False)
class PointMap:
    """Values (n,) at points (n, 3), mm, of one surface: linear in between, 0 beyond them. spectrum : as of waves."""

    surface: str
    points: NDArray[np.float64]
    values: NDArray[np.float64]
    spectrum: NDArray[np.float64] | None = None

    def at(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) values at positions (n, 3), mm, on the surface."""
        plane = _plane(self.points)
        try:
            net = Delaunay((self.points - self.points[0]) @ plane)
        except (QhullError, ValueError):
            distance, nearest = cKDTree(self.points).query(position)
            return np.where(distance < 1e-6, self.values[nearest], 0.0)
        found = LinearNDInterpolator(net, self.values, fill_value=0.0)((position - self.points[0]) @ plane)
        return np.asarray(found, float)

    def over_patches(self, centre: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.float64]:
        """(p,) means over patches with these centres (p, 3), of the places ``seen`` (n, 3) that are nearest to each."""
        if not len(centre) or not len(seen):
            return np.zeros(len(centre))
        patch = cKDTree(centre).query(seen)[1]
        count = np.bincount(patch, minlength=len(centre))
        return np.bincount(patch, self.at(seen), minlength=len(centre)) / np.maximum(count, 1)


SurfaceMap = WaveMap | PointMap


def _plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 2) the two directions in which points extend most."""
    away = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(away, full_matrices=False)
    return np.asarray(axes[:2].T)
