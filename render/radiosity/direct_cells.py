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
from scipy.spatial import KDTree

from ..device import SobolPoints, device_array, dr, lane_ranges, mi
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, intersect
from .lamp import LampSampler, direct_light
from .patches import Patches, build_patches, patch_of, patch_points

__all__ = ["DirectCells", "build_direct_cells"]

#: Points of a cell after which only uneven cells and those near them get more: a quarter of the cells in the bundled
#: scene. The mean light of its surfaces is the same within 1e-6 as with 256 points in all cells.
_FIRST_POINTS = 32

#: Rms deviation of points from a cell's plane above which it is uneven, part of its light.
_UNEVEN = 0.01

#: Distance from an uneven cell within which cells get all points, edges of the cell. The first points may miss a faint
#: half shadow: without such cells the floor of the bundled scene was brighter by 0.07 %.
_NEAR_CELLS = 2

#: Mean square added along each axis of a cell, part of its area, so that slopes that the points leave open are 0.
_LEAST_SPREAD = 1e-4

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
    first = min(samples, _FIRST_POINTS)

    def sums(some: NDArray[np.int64], begin: int, end: int) -> NDArray[np.float64]:
        """``_moments`` of some cells."""
        points = (begin, end, samples)
        ranges = lane_ranges(len(some), (end - begin) * len(lamps))
        return np.concatenate([_moments(tracer, lamps, cells, some[a:b], points, seed) for a, b in ranges])

    moments = sums(np.arange(len(cells)), 0, first)
    uneven = np.flatnonzero(_uneven(cells, moments, first, len(lamps), edge_mm))
    if samples > first and len(uneven):
        moments[uneven] += sums(uneven, first, samples)
    checkpoint()
    far = dr.opaque(mi.Float, _FAR_CELLS * edge_mm)
    fitted = (_planes(cells, moments, index)[0] for index in range(len(lamps)))
    return tuple(DirectCells(cells, device_array(mi.Float, planes), far) for planes in fitted)


def _moments(
    tracer: Tracer,
    lamps: tuple[LampSampler, ...],
    cells: Patches,
    some: NDArray[np.int64],
    span: tuple[int, int, int],
    seed: int,
) -> NDArray[np.float64]:
    """(c, n) sums over points of some cells (c,).

    ``span`` has the first point, the end, and the number of all. The sums are the number, the offsets from the centre,
    their products, and for each lamp its light, the products of light and offsets, and the square of the light.
    """
    begin, end, samples = span
    lane = device_array(mi.UInt32, some)
    points = SobolPoints(4, samples, lane, seed)
    on_cell_at = patch_points(tracer, cells)
    centre = mi.Point3f(*(device_array(mi.Float, column) for column in cells.centre[some].T))

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        position, normal = on_cell_at(lane, points.point(i, 0), points.point(i, 1))
        u, v = points.point(i, 2), points.point(i, 3)
        above = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, normal))
        free = ~above.valid | above.front
        x, y, z = position - centre
        moments = [mi.Float(1), x, y, z, x * x, x * y, x * z, y * y, y * z, z * z]
        for lamp in lamps:
            light = direct_light(tracer, lamp, position, normal, u, v, free)
            moments += [light, light * x, light * y, light * z, light * light]
        return i + 1, [old + dr.select(free, new, 0) for old, new in zip(sums, moments, strict=True)]

    start, total = dr.opaque(mi.UInt32, begin, len(some)), dr.opaque(mi.UInt32, end)
    zeros = [dr.zeros(mi.Float, len(some)) for _ in range(10 + 5 * len(lamps))]
    _, sums = dr.while_loop((start, zeros), lambda i, _: i < total, body)
    dr.eval(sums)
    return np.array([column.numpy() for column in sums], float).T


def _uneven(cells: Patches, moments: NDArray[np.float64], points: int, lamps: int, edge_mm: float) -> NDArray[np.bool_]:
    """(c,) cells with light off their plane or with covered points, and those near them."""
    uneven = moments[:, 0] < points
    for index in range(lamps):
        deviation, light = _planes(cells, moments, index)[1:]
        uneven |= deviation > (_UNEVEN * light) ** 2
    if not uneven.any():
        return uneven
    distance, _ = KDTree(cells.centre[uneven]).query(cells.centre, distance_upper_bound=_NEAR_CELLS * edge_mm)
    return np.isfinite(distance)


def _planes(cells: Patches, moments: NDArray[np.float64], lamp: int) -> tuple[NDArray[np.float64], ...]:
    """(c, 4) least-squares planes of a lamp's light, (c,) mean squares off them, and (c,) means.

    Points of a flat cell leave the slope along its normal open; it is 0. `moments` (c, n) are as of `_moments`.
    """
    means = moments[:, 1:] / np.maximum(moments[:, :1], 1)
    offset, (light, *along, square) = means[:, :3], means[:, 9 + 5 * lamp : 14 + 5 * lamp].T
    spread = means[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3) - offset[:, :, None] * offset[:, None]
    spread += _LEAST_SPREAD * cells.area[:, None, None] * np.eye(3)
    covariance = np.transpose(along) - light[:, None] * offset
    slope = np.linalg.solve(spread, covariance[..., None])[..., 0]
    planes = np.column_stack([slope, light - np.einsum("ci,ci->c", slope, offset + cells.centre)])
    return planes, square - light**2 - np.einsum("ci,ci->c", slope, covariance), light
