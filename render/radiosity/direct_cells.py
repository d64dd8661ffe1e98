"""A lamp's direct light on all surfaces as a plane in each of many small cells.

Gathering rays that end far away read it. A shadow ray tests one point of the lamp only. Where the lamp is partly
hidden, its noise is most of a gathering ray's noise. A plane by least squares has the cell's mean, and variation within
a cell is not visible from a distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import checkpoint
from numpy.typing import NDArray

from ..device import SobolPoints, device_array, dr, lane_ranges, mi
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, intersect
from .lamp import LampSampler, direct_light
from .patches import Patches, build_patches, patch_of, patch_points

__all__ = ["DirectCells", "build_direct_cells"]

#: Smallest length of a gathering ray that reads a cell, in edges of the cell.
_FAR_CELLS = 4


@dataclass(frozen=True, eq=False)
class DirectCells:
    """Direct light of one lamp in cells, as of `direct_light`."""

    #: The cells, of all surfaces.
    cells: Patches
    #: (c, 4) plane (a, b) of each cell: light a . p + b at the position p, mm.
    planes: mi.Float
    #: Smallest distance from which cells may be read, mm.
    far: mi.Float

    def at(self, hit: Hit, active: mi.Bool) -> mi.Float:
        """Direct light at hits.

        Parameters
        ----------
        hit
            The hits.
        active
            Lanes with a hit that reflects.

        Returns
        -------
        Float
            Form factor; 0 in other lanes.
        """
        cell = patch_of(self.cells, hit.triangle, hit.uv, active)
        plane = dr.gather(mi.Vector4f, self.planes, cell, active)
        position = hit.position
        light = dr.fma(plane.x, position.x, dr.fma(plane.y, position.y, dr.fma(plane.z, position.z, plane.w)))
        return dr.select(active, light, 0)


def build_direct_cells(
    tracer: Tracer, lamps: tuple[LampSampler, ...], edge_mm: float, samples: int, seed: int
) -> tuple[DirectCells, ...]:
    """Direct light of each lamp in cells.

    Points covered by an object are left out, as in `trace_exchange`.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    lamps
        Samplers of its lamps.
    edge_mm
        Largest edge of a cell, mm.
    samples
        Points in each cell, each with one point of every lamp.
    seed
        Seed of the points.

    Returns
    -------
    tuple[DirectCells, ...]
        One for each lamp, with the same cells.
    """
    checkpoint()
    cells = build_patches(tracer, edge_mm)
    parts = [
        _moments(tracer, lamps, cells, some, samples, seed) for some in lane_ranges(len(cells), samples * len(lamps))
    ]
    checkpoint()
    moments = np.concatenate(parts)
    moments[:, 1:] /= np.maximum(moments[:, :1], 1)
    far = dr.opaque(mi.Float, _FAR_CELLS * edge_mm)
    fitted = (_planes(cells, moments, 10 + 4 * index) for index in range(len(lamps)))
    return tuple(DirectCells(cells, device_array(mi.Float, planes), far) for planes in fitted)


def _moments(
    tracer: Tracer, lamps: tuple[LampSampler, ...], cells: Patches, some: tuple[int, int], samples: int, seed: int
) -> NDArray[np.float64]:
    """(c, n) sums over the points of some cells.

    They are the number, the offsets from the centre, their products, and for each lamp its light and the products of
    light and offsets.
    """
    first, end = some
    count = end - first
    lane = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, first)
    points = SobolPoints(4, samples, lane, seed)
    on_cell_at = patch_points(tracer, cells)
    centre = mi.Point3f(*(device_array(mi.Float, column) for column in cells.centre[first:end].T))

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        position, normal = on_cell_at(lane, points.point(i, 0), points.point(i, 1))
        u, v = points.point(i, 2), points.point(i, 3)
        above = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, normal))
        free = ~above.valid | above.front
        x, y, z = position - centre
        moments = [mi.Float(1), x, y, z, x * x, x * y, x * z, y * y, y * z, z * z]
        for lamp in lamps:
            light = direct_light(tracer, lamp, position, normal, u, v, free)
            moments += [light, light * x, light * y, light * z]
        return i + 1, [old + dr.select(free, new, 0) for old, new in zip(sums, moments, strict=True)]

    total = dr.opaque(mi.UInt32, samples)
    zeros = [dr.zeros(mi.Float, count) for _ in range(10 + 4 * len(lamps))]
    _, sums = dr.while_loop((dr.zeros(mi.UInt32, count), zeros), lambda i, _: i < total, body)
    dr.eval(sums)
    return np.array([column.numpy() for column in sums], float).T


def _planes(cells: Patches, moments: NDArray[np.float64], first: int) -> NDArray[np.float64]:
    """(c, 4) least-squares planes, of the smallest slope that fits.

    Points of a flat cell leave the slope along its normal open. `moments` (c, n) are means over the points; from column
    `first` on they hold light, and light times the three offsets.
    """
    offset, light = moments[:, 1:4], moments[:, first]
    spread = moments[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) - offset[:, :, None] * offset[:, None]
    covariance = moments[:, first + 1 : first + 4] - light[:, None] * offset
    slope = np.einsum("cij,cj->ci", np.linalg.pinv(spread, rcond=1e-3, hermitian=True), covariance)
    return np.column_stack([slope, light - np.einsum("ci,ci->c", slope, offset + cells.centre)])
