"""Linear variation of radiance across a patch, from its neighbours, so that fewer patches are needed.

Radiance changes steeply where surfaces meet, and there patches see each other closely: patches of constant radiance
make dark corners too bright, even with a final gather.
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
#: Smallest uncovered share of a neighbour used for slopes.
_LEAST_FREE = 0.1


@dataclass(frozen=True, eq=False)
class PatchSlopes:
    """Radiance at a point y of patch j: b_j + sum over neighbours n of (b_n - b_j) across_n . (y - centre_j).

    A least-squares plane through the at most three neighbours on the same flat face; its mean over the patch is b_j.
    neighbour : (p, 3) indices, the patch itself where there is none. across : (p, 3, 3) 1/mm.
    centre : (p, 3) mm, of the uncovered part of the patch.
    """

    neighbour: NDArray[np.int64]
    across: NDArray[np.float64]
    centre: NDArray[np.float64]
    packed_neighbour: mi.UInt32
    packed_across: mi.Float
    packed_centre: mi.Float

    def weights(self, patch: mi.UInt32, position: mi.Point3f, active: mi.Bool) -> list[tuple[mi.UInt32, mi.Float]]:
        """Patches and weights of which the radiance at ``position`` is the weighted sum; the weights sum to 1."""
        offset = position - dr.gather(mi.Point3f, self.packed_centre, patch, active)
        own, parts = mi.Float(1), []
        for k in range(3):
            entry = patch * 3 + k
            weight = dr.dot(dr.gather(mi.Vector3f, self.packed_across, entry, active), offset)
            parts.append((dr.gather(mi.UInt32, self.packed_neighbour, entry, active), weight))
            own -= weight
        return [(patch, own), *parts]

    def at(self, values: NDArray, patch: NDArray, position: NDArray) -> NDArray[np.float64]:
        """(n, k) values (p, k) of the patches, extrapolated to positions (n, 3) on patches (n,)."""
        weight = np.einsum("nix,nx->ni", self.across[patch], position - self.centre[patch])
        change = values[self.neighbour[patch]] - values[patch][:, None]
        return values[patch] + np.einsum("ni,nik->nk", weight, change)


def build_slopes(tracer: Tracer, patches: Patches) -> PatchSlopes:
    """Find the neighbours of each patch and the planes through them."""
    free, centre = _free_part(tracer, patches)
    neighbour = _neighbours(patches)
    itself = np.arange(len(patches))[:, None]
    known = (neighbour >= 0) & (free[neighbour] >= _LEAST_FREE) & (free[:, None] > 0)
    neighbour = np.where(known, neighbour, itself)
    ways = centre[neighbour] - centre[:, None]
    # with fewer than two neighbours, the pseudo-inverse gives the smallest slope
    inverse = np.linalg.pinv(np.einsum("pnx,pny->pxy", ways, ways), rcond=1e-4, hermitian=True)
    across = np.einsum("pxy,pny->pnx", inverse, ways)
    return PatchSlopes(
        neighbour,
        across,
        centre,
        packed_neighbour=device_array(mi.UInt32, neighbour),
        packed_across=device_array(mi.Float, across),
        packed_centre=device_array(mi.Float, centre),
    )


def _neighbours(patches: Patches) -> NDArray[np.int64]:
    """(p, 3) the patch of the same flat face across each edge, -1 for none; found by the midpoints of edges.

    Groups have none: their light is taken as constant.
    """
    alone = np.flatnonzero(np.bincount(patches.patch)[patches.patch] == 1)
    corners, patch = patches.corners[alone], np.repeat(patches.patch[alone], 3)
    result = np.full((len(patches), 3), -1)
    if not len(alone):
        return result
    middles = (0.5 * (corners + np.roll(corners, -1, axis=1))).reshape(-1, 3)
    one, other = cKDTree(middles).query_pairs(1e-6 * np.ptp(middles, axis=0).max(), output_type="ndarray").T
    same = patches.facet[patch[one]] == patches.facet[patch[other]]
    one, other = one[same], other[same]
    result[patch[one], one % 3], result[patch[other], other % 3] = patch[other], patch[one]
    return result


def _free_part(tracer: Tracer, patches: Patches) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p,) uncovered share of each patch and (p, 3) its centre; from covered points, a ray upwards hits a back."""
    lane = dr.arange(mi.UInt32, len(patches) * _POINTS)
    patch, i = lane // _POINTS, lane % _POINTS
    points = SobolPoints(2, _POINTS, patch, seed=0)
    position, normal = patch_points(tracer, patches)(patch, points.point(i, 0), points.point(i, 1))
    hit = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, normal))
    free = np.array(~hit.valid | hit.front).reshape(-1, _POINTS)
    share = free.mean(axis=1)
    total = np.einsum("pi,pix->px", free, np.array(position).T.reshape(-1, _POINTS, 3))
    partly = ((share > 0) & (share < 1))[:, None]
    return share, np.where(partly, total / np.maximum(free.sum(axis=1), 1)[:, None], patches.centre)
