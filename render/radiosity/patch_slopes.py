"""Linear variation of radiance across a patch, from its neighbours.

Radiance changes steeply where surfaces meet, and there patches see each other closely. Patches of constant radiance
make dark corners too bright, even with a final gather. With slopes fewer patches are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..device import SobolPoints, device_array, dr, mi
from ..visibility import RAY_OFFSET_MM, Tracer, intersect
from .patches import Patches, patch_points

__all__ = ["PatchSlopes", "build_slopes"]

#: Points of a patch that are tested for a covering object.
_POINTS = 64
#: Smallest uncovered share of a neighbour that is used for slopes.
_LEAST_FREE = 0.1


@dataclass(frozen=True, eq=False)
class PatchSlopes:
    """Slopes of radiance of p patches.

    The radiance at a point y of patch j is b_j + Sum_n (b_n - b_j) a_n . (y - c_j) over its neighbours n. This is a
    least-squares plane through the at most three neighbours on the same flat face, with the mean b_j over the patch.
    """

    #: (p, 3) indices of the neighbours; the patch itself where there is none.
    neighbour: NDArray[np.int64]
    #: (p, 3, 3) vectors a_n, 1/mm.
    across: NDArray[np.float64]
    #: (p, 3) centre c_j of the uncovered part of the patch, mm.
    centre: NDArray[np.float64]
    #: `neighbour` on the device.
    packed_neighbour: mi.UInt32
    #: `across` on the device.
    packed_across: mi.Float
    #: `centre` on the device.
    packed_centre: mi.Float

    def weights(self, patch: mi.UInt32, position: mi.Point3f, active: mi.Bool) -> list[tuple[mi.UInt32, mi.Float]]:
        """Weights of patches in the radiance at a position.

        Parameters
        ----------
        patch
            Patch of each lane.
        position
            Points on the patches, mm.
        active
            Lanes that are evaluated.

        Returns
        -------
        list[tuple[UInt32, Float]]
            Patches and weights, which sum to 1: the radiance is the weighted sum of theirs.
        """
        offset = position - dr.gather(mi.Point3f, self.packed_centre, patch, active)
        own_weight, parts = mi.Float(1), []
        for k in range(3):
            entry = patch * 3 + k
            weight = dr.dot(dr.gather(mi.Vector3f, self.packed_across, entry, active), offset)
            parts.append((dr.gather(mi.UInt32, self.packed_neighbour, entry, active), weight))
            own_weight -= weight
        return [(patch, own_weight), *parts]

    def at(self, values: NDArray, patch: NDArray, position: NDArray) -> NDArray[np.float64]:
        """Values of patches, extrapolated to positions.

        Parameters
        ----------
        values
            (p, k) values of the patches.
        patch
            (n,) patch of each position.
        position
            (n, 3) positions, mm.

        Returns
        -------
        NDArray
            (n, k) values there.
        """
        weight = np.einsum("nix,nx->ni", self.across[patch], position - self.centre[patch])
        change = values[self.neighbour[patch]] - values[patch][:, None]
        return values[patch] + np.einsum("ni,nik->nk", weight, change)


def build_slopes(tracer: Tracer, patches: Patches) -> PatchSlopes:
    """Slopes of a scene's patches.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    patches
        The patches.

    Returns
    -------
    PatchSlopes
        The slopes; with fewer than two usable neighbours the smallest slope that fits.
    """
    free, centre = _free_part(tracer, patches)
    neighbour = _neighbours(patches)
    itself = np.arange(len(patches))[:, None]
    usable = (neighbour >= 0) & (free[neighbour] >= _LEAST_FREE) & (free[:, None] > 0)
    neighbour = np.where(usable, neighbour, itself)
    offsets = centre[neighbour] - centre[:, None]
    # with fewer than two neighbours, the pseudo-inverse gives the smallest slope
    inverse = np.linalg.pinv(np.einsum("pnx,pny->pxy", offsets, offsets), rcond=1e-4, hermitian=True)
    across = np.einsum("pxy,pny->pnx", inverse, offsets)
    return PatchSlopes(
        neighbour,
        across,
        centre,
        packed_neighbour=device_array(mi.UInt32, neighbour),
        packed_across=device_array(mi.Float, across),
        packed_centre=device_array(mi.Float, centre),
    )


def _neighbours(patches: Patches) -> NDArray[np.int64]:
    """(p, 3) patch of the same flat face across each edge, -1 for none.

    They are found by the midpoints of edges. Groups have none: their light is taken as constant.
    """
    alone = np.flatnonzero(np.bincount(patches.patch)[patches.patch] == 1)
    corners, patch = patches.corners[alone], np.repeat(patches.patch[alone], 3)
    result = np.full((len(patches), 3), -1)
    if not len(alone):
        return result
    middles = (0.5 * (corners + np.roll(corners, -1, axis=1))).reshape(-1, 3)
    first, second = cKDTree(middles).query_pairs(1e-6 * np.ptp(middles, axis=0).max(), output_type="ndarray").T
    on_face = patches.facet[patch[first]] == patches.facet[patch[second]]
    first, second = first[on_face], second[on_face]
    result[patch[first], first % 3], result[patch[second], second % 3] = patch[second], patch[first]
    return result


def _free_part(tracer: Tracer, patches: Patches) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p,) uncovered share of each patch, and (p, 3) centre of this part.

    A point is covered if a ray upwards from it hits a back side.
    """
    lane = dr.arange(mi.UInt32, len(patches) * _POINTS)
    patch, i = lane // _POINTS, lane % _POINTS
    points = SobolPoints(2, _POINTS, patch, seed=0)
    position, normal = patch_points(tracer, patches)(patch, points.point(i, 0), points.point(i, 1))
    hit = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, normal))
    uncovered = ~hit.valid | hit.front
    dr.eval(uncovered, position)  # together: one kernel
    free = np.array(uncovered).reshape(-1, _POINTS)
    share = free.mean(axis=1)
    points_mm = np.stack([axis.numpy() for axis in position]).T.reshape(-1, _POINTS, 3)
    total = np.einsum("pi,pix->px", free, points_mm)
    partly = ((share > 0) & (share < 1))[:, None]
    return share, np.where(partly, total / np.maximum(free.sum(axis=1), 1)[:, None], patches.centre)
