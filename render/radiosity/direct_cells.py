"""A lamp's direct light on all surfaces as a plane in each of many small cells, for gathering rays that end far away.

A shadow ray tells of one point of the lamp only, and where the lamp is partly hidden its noise is most of a gathering
ray's. A plane by least squares has a cell's mean, and what it smooths within a cell is not seen from a distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import SobolPoints, device_array, dr, mi
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, intersect
from .lamp import LampSampler, direct_light
from .patches import Patches, build_patches, patch_of, patch_points

__all__ = ["DirectCells", "build_direct_cells"]

#: A gathering ray longer than this many edges of a cell reads the cell.
_FAR_CELLS = 4


@dataclass(frozen=True, eq=False)
class DirectCells:
    """Direct light as in ``direct_light``. planes : (a, b) of each cell: a . p + b at position p, mm.
    far : distance from which they may be read, mm."""

    cells: Patches
    planes: mi.Float
    far: mi.Float

    def at(self, hit: Hit, active: mi.Bool) -> mi.Float:
        """Direct light at reflecting hits, 0 for others."""
        cell = patch_of(self.cells, hit.triangle, hit.uv, active)
        plane = dr.gather(mi.Vector4f, self.planes, cell, active)
        place = hit.position
        light = dr.fma(plane.x, place.x, dr.fma(plane.y, place.y, dr.fma(plane.z, place.z, plane.w)))
        return dr.select(active, light, 0)


def build_direct_cells(
    tracer: Tracer, lamps: tuple[LampSampler, ...], edge_mm: float, samples: int, seed: int
) -> tuple[DirectCells, ...]:
    """Those of each lamp. edge_mm : largest edge of a cell. samples : points in each cell, with one of the lamp each.

    Points covered by an object are left out, as in ``trace_exchange``.
    """
    cells = build_patches(tracer, edge_mm)
    lane = dr.arange(mi.UInt32, len(cells))
    points = SobolPoints(4, samples, lane, seed)
    on_cell_at = patch_points(tracer, cells)
    centre = mi.Point3f(*(device_array(mi.Float, column) for column in cells.centre.T))

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
    zeros = [dr.zeros(mi.Float, len(cells)) for _ in range(10 + 4 * len(lamps))]
    _, sums = dr.while_loop((dr.zeros(mi.UInt32, len(cells)), zeros), lambda i, _: i < total, body)
    dr.eval(sums)
    moments = np.array([one.numpy() for one in sums], float).T
    moments[:, 1:] /= np.maximum(moments[:, :1], 1)
    far = dr.opaque(mi.Float, _FAR_CELLS * edge_mm)
    fitted = (_planes(cells, moments, 10 + 4 * index) for index in range(len(lamps)))
    return tuple(DirectCells(cells, device_array(mi.Float, planes), far) for planes in fitted)


def _planes(cells: Patches, moments: NDArray[np.float64], first: int) -> NDArray[np.float64]:
    """(c, 4) least-squares planes, of the smallest slope that fits: points of a flat cell say nothing of one axis.

    moments : (c, n) means over the points; from column ``first`` on light, and light times the three offsets.
    """
    place, light = moments[:, 1:4], moments[:, first]
    spread = moments[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) - place[:, :, None] * place[:, None]
    together = moments[:, first + 1 : first + 4] - light[:, None] * place
    slope = np.einsum("cij,cj->ci", np.linalg.pinv(spread, rcond=1e-3, hermitian=True), together)
    return np.column_stack([slope, light - np.einsum("ci,ci->c", slope, place + cells.centre)])
