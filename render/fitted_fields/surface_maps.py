"""Maps on surfaces of the scene by position in mm: smooth waves, or values at points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

__all__ = ["PointMap", "SurfaceMap", "WaveMap"]


@dataclass(frozen=True, eq=False)
class WaveMap:
    """Sum of products of cosines on one surface.

    The value at x is the sum over n of values[n] times the product over the axes of
    cos(pi waves[n] (x - low) / extent).
    """

    #: Name of the surface.
    surface: str
    #: (3,) lowest corner of the region where the map is defined, mm.
    low: NDArray[np.float64]
    #: (3,) extent of that region, mm.
    extent: NDArray[np.float64]
    #: (n, 3) half waves over the extent along x, y and z.
    waves: NDArray[np.float64]
    #: (n,) coefficients.
    values: NDArray[np.float64]
    #: (band,) factor of this surface in addition to the field's spectrum; None for 1.
    spectrum: NDArray[np.float64] | None = None

    def at(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values on the surface.

        Parameters
        ----------
        position
            (n, 3) positions, mm.

        Returns
        -------
        NDArray
            (n,) values.
        """
        relative = (position - self.low) / np.maximum(self.extent, 1e-9)
        phases = np.cos(np.pi * relative[:, None, :] * self.waves[None])
        return np.asarray(phases.prod(axis=2) @ self.values)

    def over_patches(self, centre: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        """Means over patches, which are small against the waves: the values at their centres.

        Parameters
        ----------
        centre
            (p, 3) centres of the patches, mm.
        _
            Positions of fragments, which waves do not need.

        Returns
        -------
        NDArray
            (p,) means.
        """
        return self.at(centre)


@dataclass(frozen=True, eq=False)
class PointMap:
    """Values at points of one surface: linear between them, 0 outside their convex hull.

    Points on one line have no triangles; the map is then 0 except at the points.
    """

    #: Name of the surface.
    surface: str
    #: (n, 3) points, mm.
    points: NDArray[np.float64]
    #: (n,) values at the points.
    values: NDArray[np.float64]
    #: (band,) factor of this surface in addition to the field's spectrum; None for 1.
    spectrum: NDArray[np.float64] | None = None

    def at(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values on the surface.

        Parameters
        ----------
        position
            (n, 3) positions, mm.

        Returns
        -------
        NDArray
            (n,) values.
        """
        from scipy.interpolate import LinearNDInterpolator  # slow to import

        plane = _plane(self.points)
        try:
            triangles = Delaunay((self.points - self.points[0]) @ plane)
        except (QhullError, ValueError):
            distance, nearest = cKDTree(self.points).query(position)
            return np.where(distance < 1e-6, self.values[nearest], 0.0)
        interpolated = LinearNDInterpolator(triangles, self.values, fill_value=0.0)((position - self.points[0]) @ plane)
        return np.asarray(interpolated, float)

    def over_patches(self, centre: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Means over patches, of the fragments nearest to each centre.

        Parameters
        ----------
        centre
            (p, 3) centres of the patches, mm.
        position
            (n, 3) positions of the fragments, mm.

        Returns
        -------
        NDArray
            (p,) means; 0 for a patch without fragments.
        """
        if not len(centre) or not len(position):
            return np.zeros(len(centre))
        patch = cKDTree(centre).query(position)[1]
        count = np.bincount(patch, minlength=len(centre))
        return np.bincount(patch, self.at(position), minlength=len(centre)) / np.maximum(count, 1)


#: A map on a surface.
SurfaceMap = WaveMap | PointMap


def _plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 2) unit vectors of the two directions in which points extend most."""
    away = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(away, full_matrices=False)
    return np.asarray(axes[:2].T)
