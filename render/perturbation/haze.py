"""Transport of light for haze.

Cells of air exchange light with lamps and patches; the lamps' light in the air is known along camera rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..device import SobolPoints, device_array, dr, mi
from ..radiosity import LampSampler, lamp_point, patch_of
from ..visibility import Tracer, intersect, visible
from .patch_transport import PatchTransport

__all__ = ["STEPS", "AirLamp", "AirTransport", "air_transport"]

#: Number of segments of each camera ray.
STEPS = 16

#: Cells in x, y and z of the air in the box.
_CELLS_INSIDE = (8, 8, 8)

#: Cells in x, y and z of the air between box and camera.
_CELLS_IN_FRONT = (6, 6, 6)

#: Distance by which the air in front of the box extends beyond its sides, mm.
_SIDE_MARGIN_MM = 350.0

#: Rays of each cell of air.
_CELL_SAMPLES = 2048

#: Samples of each lamp's light in each segment of a camera ray.
_RAY_SAMPLES = 32


#: Most pixels of a picture whose weights of cells are stored: 1 kB each.
_STORED_PIXELS = 2**16


@dataclass(frozen=True, eq=False)
class AirLamp:
    """One lamp's light in the air."""

    #: (v,) fraction of the sphere of directions that the lamp covers, weighted with its pattern.
    cells: NDArray[np.float64]
    #: (y, x, STEPS) the same, mean over each segment of a pixel's central ray.
    rays: NDArray[np.float64]
    #: (3,) centre of the lamp, mm.
    centre: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AirTransport:
    """The air between the camera and the back wall; fractions are of the sphere of directions."""

    #: Centres of the cells along x, y, z, mm: of the air in the box, then of the air in front of it.
    axes: tuple[tuple[NDArray[np.float64], ...], ...]
    #: z of the plane between the two, mm.
    front_mm: float
    #: (v, 3) lower corners of the cells, mm.
    corner: NDArray[np.float64]
    #: (v, 3) edges of the cells, mm.
    size: NDArray[np.float64]
    #: (v,) volume of air in each cell, mm^3.
    volume: NDArray[np.float64]
    #: (v, p) fraction covered by each patch, mean over the cell.
    patch_coverage: NDArray[np.float32]
    #: (v,) fraction that meets nothing.
    escape: NDArray[np.float64]
    #: Light of each lamp.
    lamps: tuple[AirLamp, ...]
    #: (y, x) distance to the surface seen, mm; to the plane of the back wall where there is none.
    depth: NDArray[np.float64]
    #: (y, x, 3) directions of the central rays.
    direction: NDArray[np.float64]
    #: (3,) position of the camera, mm.
    eye_mm: NDArray[np.float64]

    @property
    def centres(self) -> NDArray[np.float64]:
        """(v, 3) centres of the cells, mm."""
        return self.corner + self.size / 2

    @cached_property
    def _distances(self) -> NDArray[np.float64]:
        """(v, v) mm between the centres of cells; 1 for a cell and itself."""
        away = np.linalg.norm(self.centres[:, None] - self.centres, axis=-1)
        np.fill_diagonal(away, 1.0)
        return away

    @cached_property
    def _stored(self) -> dict[int, csr_array]:
        """Weights of the cells by segment, of a picture small enough to store them."""
        return {}

    def at_step(self, step: int, values: NDArray) -> NDArray[np.float32]:
        """Light of the cells in the middle of a segment of the central rays, interpolated.

        Parameters
        ----------
        step
            Number of the segment, from 0.
        values
            (v, w) light in the cells.

        Returns
        -------
        NDArray
            (y, x, w) light; 0 at the sides of the box, where only the black backs of its walls are seen.
        """
        weights = self._stored.get(step)
        if weights is None:
            weights = self.weights_at(self.eye_mm + ((step + 0.5) / STEPS * self.depth)[..., None] * self.direction)
            if self.depth.size <= _STORED_PIXELS:
                self._stored[step] = weights
        return (weights @ values.astype(np.float32)).reshape(*self.depth.shape, -1)

    def weights_at(self, points_mm: NDArray) -> csr_array:
        """Weights of the cells for light at points: linear between their centres and beyond them.

        Parameters
        ----------
        points_mm
            (..., 3) points, mm.

        Returns
        -------
        csr_array
            (n, v) weights, points in order; 0 at the sides of the box, where the black backs of its walls are seen.
        """
        points = points_mm.reshape(-1, 3)
        part = np.minimum(points[:, 2] < self.front_mm, len(self.axes) - 1)
        aside = [
            np.abs(points[:, i] - axis.mean()) > len(axis) * (axis[1] - axis[0]) / 2
            for i, axis in enumerate(self.axes[0][:2])
        ]
        in_view = (part > 0) | ~np.any(aside, axis=0)
        cells, weights = np.zeros((len(points), 8), np.int32), np.zeros((len(points), 8), np.float32)
        first = 0
        for k, axes in enumerate(self.axes):
            inside = np.flatnonzero((part == k) & in_view)
            cell, weight = np.zeros((len(inside), 1), np.int32), np.ones((len(inside), 1))
            for i, axis in enumerate(axes):
                along = (points[inside, i] - axis[0]) / (axis[1] - axis[0])
                lower = np.clip(np.floor(along).astype(np.int32), 0, len(axis) - 2)
                beyond = (along - lower)[:, None]
                cell = len(axis) * cell + lower[:, None]
                cell = np.concatenate([cell, cell + 1], axis=1)
                weight = np.concatenate([weight * (1 - beyond), weight * beyond], axis=1)
            cells[inside], weights[inside] = first + cell, weight
            first += int(np.prod([len(axis) for axis in axes]))
        ends = np.arange(0, weights.size + 1, 8, dtype=np.int32)
        return csr_array((weights.ravel(), cells.ravel(), ends), shape=(len(points), first))

    def between_cells(self, extinction_per_mm: float) -> NDArray[np.float64]:
        """Mean radiance in each cell per source in each other cell.

        Occlusion by blocks is ignored. A cell's contribution to itself is that of a ball of the same volume.

        Parameters
        ----------
        extinction_per_mm
            Extinction coefficient of the air, 1/mm.

        Returns
        -------
        NDArray
            (v, v) mm: radiance in the cell of a row per source (radiance per mm) in the cell of a column.
        """
        away = self._distances
        radius = (3 * self.volume / (4 * np.pi)) ** (1 / 3)
        matrix = self.volume * np.exp(-extinction_per_mm * away) / (4 * np.pi * away**2)
        np.fill_diagonal(matrix, radius)
        return matrix


@lru_cache(maxsize=2)
def air_transport(transport: PatchTransport, seed: int = 0) -> AirTransport:
    """Exchange of the air with a scene's patches and lamps; the last two are cached.

    Parameters
    ----------
    transport
        Exchange of the scene's surfaces.
    seed
        Seed of the random numbers.

    Returns
    -------
    AirTransport
        The traced exchange.
    """
    light, camera = transport.light, transport.camera
    tracer, patches = light.tracer, light.patches
    corners = tracer.scene.corners_mm
    low, high = corners.min(axis=0), corners.max(axis=0)
    zones = [_cells(low, high, _CELLS_INSIDE)]
    eye = camera.position_mm[2]
    if eye < low[2]:
        margin = np.array([_SIDE_MARGIN_MM, _SIDE_MARGIN_MM, 0.0])
        zones.append(
            _cells(np.append((low - margin)[:2], eye), np.append((high + margin)[:2], low[2]), _CELLS_IN_FRONT)
        )
    corner, size = (np.concatenate([zone[i] for zone in zones]) for i in (1, 2))
    count = len(corner)
    lane = dr.arange(mi.UInt32, count)
    first, extent = mi.Point3f(*_columns(corner)), mi.Vector3f(*_columns(size))
    random = SobolPoints(7, _CELL_SAMPLES, lane, seed)
    matrix = dr.zeros(mi.Float, count * len(patches))
    patch_count = dr.opaque(mi.UInt32, len(patches))
    empty, exposed = (dr.zeros(mi.Float, count) for _ in range(2))
    from_lamps = [dr.zeros(mi.Float, count) for _ in light.lamps]

    def body(i: mi.UInt32) -> tuple[mi.UInt32]:
        u = [random.point(i, k) for k in range(7)]
        point = first + extent * mi.Vector3f(u[0], u[1], u[2])
        ray = mi.Ray3f(point, mi.warp.square_to_uniform_sphere(mi.Point2f(u[3], u[4])))
        hit = intersect(tracer, ray)
        air = ~hit.valid | hit.front
        dr.scatter_add(exposed, mi.Float(1), lane, air, mode=dr.ReduceMode.Direct)
        dr.scatter_add(empty, mi.Float(1), lane, ~hit.valid, mode=dr.ReduceMode.Direct)
        patch = patch_of(patches, hit.triangle, hit.uv, hit.reflecting)
        dr.scatter_add(matrix, mi.Float(1), lane * patch_count + patch, hit.reflecting, mode=dr.ReduceMode.Direct)
        for lamp_light, lamp in zip(from_lamps, light.lamps, strict=True):
            arriving = _from_lamp(tracer, lamp, point, u[5], u[6])
            dr.scatter_add(lamp_light, arriving, lane, air, mode=dr.ReduceMode.Direct)
        return (i + 1,)

    total = dr.opaque(mi.UInt32, _CELL_SAMPLES)
    dr.while_loop((dr.zeros(mi.UInt32, count),), lambda i: i < total, body)
    dr.eval(matrix, empty, exposed, from_lamps)
    free = np.array(exposed).astype(float)
    share = 1 / np.maximum(free, 1)
    centres = [tracer.lamp_triangles(k).reshape(-1, 3).mean(axis=0) for k in range(len(light.lamps))]
    depth, direction = _depth(transport, high[2], centres)
    eye_mm = camera.position_mm
    return AirTransport(
        axes=tuple(zone[0] for zone in zones),
        front_mm=float(low[2]),
        corner=corner,
        size=size,
        volume=free / _CELL_SAMPLES * size.prod(axis=1),
        patch_coverage=np.array(matrix).reshape(count, -1) * share[:, None].astype(np.float32),
        escape=np.array(empty) * share,
        lamps=tuple(
            AirLamp(np.array(lamp_light) * share, _along_rays(tracer, lamp, eye_mm, depth, direction, seed), centre)
            for lamp_light, lamp, centre in zip(from_lamps, light.lamps, centres, strict=True)
        ),
        depth=depth,
        direction=direction,
        eye_mm=eye_mm,
    )


def _cells(low: NDArray, high: NDArray, shape: tuple[int, int, int]) -> tuple[tuple[NDArray, ...], NDArray, NDArray]:
    """Centres along the axes, lower corners (v, 3) and sizes (v, 3) of equal cells."""
    size = (high - low) / shape
    axes = tuple(low[i] + (np.arange(shape[i]) + 0.5) * size[i] for i in range(3))
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return axes, centres - size / 2, np.broadcast_to(size, centres.shape)


def _columns(values: NDArray) -> list[mi.Float]:
    """Coordinates of points (n, 3), one array each."""
    return [device_array(mi.Float, values[:, i]) for i in range(3)]


def _from_lamp(tracer: Tracer, lamp: LampSampler, point: mi.Point3f, u: mi.Float, v: mi.Float) -> mi.Float:
    """One sample of the lamp's radiance averaged over the sphere of directions."""
    every = mi.Bool(True)
    _, way, _ = lamp_point(lamp, point, -lamp.normal, u, v, every)
    # With the normal towards the sampled point, the form factor is a solid angle over pi.
    weight, way, _ = lamp_point(lamp, point, dr.normalize(way), u, v, every)
    return dr.select(visible(tracer, point, point + way, weight > 0), weight / 4, 0)


def _along_rays(
    tracer: Tracer, lamp: LampSampler, eye: NDArray, depth: NDArray, direction: NDArray, seed: int
) -> NDArray[np.float64]:
    """(y, x, STEPS) a lamp's radiance averaged over the sphere, in segments of the central rays."""
    count = depth.size * STEPS
    lane = dr.arange(mi.UInt32, count)
    pixel, step = lane // STEPS, mi.Float(lane % STEPS)
    toward = dr.gather(mi.Vector3f, device_array(mi.Float, direction), pixel)
    length = dr.gather(mi.Float, device_array(mi.Float, depth), pixel) * (1 / STEPS)
    start = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in eye))
    random = SobolPoints(3, _RAY_SAMPLES, lane, seed)

    def body(i: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        point = start + toward * (length * (step + random.point(i, 0)))
        return i + 1, total + _from_lamp(tracer, lamp, point, random.point(i, 1), random.point(i, 2))

    limit = dr.opaque(mi.UInt32, _RAY_SAMPLES)
    _, total = dr.while_loop((dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), lambda i, _: i < limit, body)
    return np.array(total, float).reshape(*depth.shape, STEPS) / _RAY_SAMPLES


def _depth(transport: PatchTransport, back_mm: float, centres: list[NDArray]) -> tuple[NDArray, NDArray]:
    """(y, x) mean distance to the surfaces that each pixel sees, mm, and directions (y, x, 3).

    centres : of the lamps, mm.
    """
    camera = transport.camera
    rows, columns = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    direction = camera.directions(columns, rows)
    reach = np.linalg.norm(transport.position - camera.position_mm, axis=1)

    def per_pixel(values: NDArray) -> NDArray:
        return np.bincount(transport.pixel, values, minlength=rows.size).reshape(rows.shape)

    on_lamp = np.maximum(transport.covered - per_pixel(transport.coverage), 0)
    beyond = (back_mm - camera.position_mm[2]) / np.maximum(direction[..., 2], 1e-3)
    visibility = (
        transport.lamp_radiance > 0
    ) + 1e-9  # the lamps' mean distance where none is seen, and where dark ones are
    to_lamps = np.linalg.norm(np.array(centres) - camera.position_mm, axis=1)
    to_lamp = np.einsum("jyx,j->yx", visibility, to_lamps) / visibility.sum(axis=0)
    depth = per_pixel(transport.coverage * reach) + on_lamp * to_lamp + (1 - transport.covered) * beyond
    return depth, direction
