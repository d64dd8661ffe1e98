"""Light in the air: what cells of air exchange with lamp and patches, and the lamp's light along camera rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from .lamp import LampSampler, lamp_point
from .patch_transport import PatchTransport
from .patches import patch_of
from .sampling import SobolPoints
from .tracer import Tracer, intersect, visible

__all__ = ["STEPS", "AirTransport", "air_transport"]

#: Parts of each camera ray's way through the air.
STEPS = 16

#: Cells in x, y and z of the air in the box, and of that between box and camera, which reaches further aside.
_INSIDE, _BEFORE = (8, 8, 8), (6, 6, 6)
_ASIDE_MM = 350.0

_CELL_SAMPLES, _RAY_SAMPLES = 2048, 32


@dataclass(frozen=True, eq=False)
class AirTransport:
    """Air between the camera and the back wall, all per mean over directions (a full sphere is 1).

    axes : centres of the cells, mm, of the air in the box, which come first, and of that before it.
    front_mm : the plane between them. corner, size : (v, 3) of the cells, mm. volume : (v,) mm^3 of a cell that is
    air. seen : (v, p) part of the sphere that a patch fills, mean over the cell. escape : (v,) part that meets
    nothing. lamp : (v,) the lamp's part, weighted with its pattern. ray_lamp : (y, x, STEPS) the same, mean over
    each part of a pixel's central ray. depth : (y, x) mm to what a pixel sees; to the back wall's plane where it
    sees nothing. direction : (y, x, 3). lamp_centre : (3,) mm.
    """

    axes: tuple[tuple[NDArray[np.float64], ...], ...]
    front_mm: float
    corner: NDArray[np.float64]
    size: NDArray[np.float64]
    volume: NDArray[np.float64]
    seen: NDArray[np.float32]
    escape: NDArray[np.float64]
    lamp: NDArray[np.float64]
    ray_lamp: NDArray[np.float64]
    depth: NDArray[np.float64]
    direction: NDArray[np.float64]
    lamp_centre: NDArray[np.float64]

    @property
    def centres(self) -> NDArray[np.float64]:
        """(v, 3) mm."""
        return self.corner + self.size / 2

    def at(self, points_mm: NDArray, values: NDArray) -> NDArray[np.float64]:
        """(..., w) at points (..., 3) of a smooth quantity (v, w) known in the cells."""
        parts, start = [], 0
        for axes in self.axes:
            shape = tuple(len(axis) for axis in axes)
            own = values[start : start + int(np.prod(shape))].reshape(*shape, -1)
            parts.append(RegularGridInterpolator(axes, own, bounds_error=False, fill_value=None)(points_mm))
            start += int(np.prod(shape))
        return np.where(points_mm[..., 2:] < self.front_mm, parts[-1], parts[0])

    def between_cells(self, extinction_per_mm: float) -> NDArray[np.float64]:
        """(v, v) mm: mean radiance in a row's cell per source (radiance per mm) of a column's.

        Blocks stand in nobody's way. A cell's own light is that of a ball of its volume.
        """
        away = np.linalg.norm(self.centres[:, None] - self.centres, axis=-1)
        own = (3 * self.volume / (4 * np.pi)) ** (1 / 3)
        np.fill_diagonal(away, 1.0)
        matrix = self.volume * np.exp(-extinction_per_mm * away) / (4 * np.pi * away**2)
        np.fill_diagonal(matrix, own)
        return matrix


@lru_cache(maxsize=2)
def air_transport(transport: PatchTransport, seed: int = 0) -> AirTransport:
    """Trace the exchange of the air with a scene's patches; kept for the next call."""
    light, camera = transport.light, transport.camera
    tracer, patches = light.tracer, light.patches
    corners = np.concatenate([s.vertices_mm for s in tracer.scene.surfaces])
    low, high = corners.min(axis=0), corners.max(axis=0)
    zones = [_cells(low, high, _INSIDE)]
    eye = camera.position_mm[2]
    if eye < low[2]:
        aside = np.array([_ASIDE_MM, _ASIDE_MM, 0.0])
        zones.append(
            _cells(np.append((low - aside)[:2], eye), np.append((high + aside)[:2], low[2]), _BEFORE)
        )
    corner, size = (np.concatenate([zone[i] for zone in zones]) for i in (1, 2))
    count = len(corner)
    lane = dr.arange(mi.UInt32, count)
    first, extent = mi.Point3f(*_columns(corner)), mi.Vector3f(*_columns(size))
    random = SobolPoints(7, _CELL_SAMPLES, lane, seed)
    matrix = dr.zeros(mi.Float, count * len(patches))
    empty, exposed, lit = (dr.zeros(mi.Float, count) for _ in range(3))

    def body(i: mi.UInt32) -> tuple[mi.UInt32]:
        u = [random.point(i, k) for k in range(7)]
        point = first + extent * mi.Vector3f(u[0], u[1], u[2])
        ray = mi.Ray3f(point, mi.warp.square_to_uniform_sphere(mi.Point2f(u[3], u[4])))
        hit = intersect(tracer, ray)
        air = ~hit.valid | hit.front
        dr.scatter_add(exposed, mi.Float(1), lane, air)
        dr.scatter_add(empty, mi.Float(1), lane, ~hit.valid)
        patch = patch_of(patches, hit.triangle, hit.uv, hit.painted)
        dr.scatter_add(matrix, mi.Float(1), lane * len(patches) + patch, hit.painted)
        dr.scatter_add(lit, _from_lamp(tracer, light.lamp, point, u[5], u[6]), lane, air)
        return (i + 1,)

    total = dr.opaque(mi.UInt32, _CELL_SAMPLES)
    dr.while_loop((dr.zeros(mi.UInt32, count),), lambda i: i < total, body)
    dr.eval(matrix, empty, exposed, lit)
    free = np.array(exposed).astype(float)
    share = 1 / np.maximum(free, 1)
    depth, direction, lamp_centre = _depth(transport, high[2])
    return AirTransport(
        axes=tuple(zone[0] for zone in zones),
        front_mm=float(low[2]),
        corner=corner,
        size=size,
        volume=free / _CELL_SAMPLES * size.prod(axis=1),
        seen=np.array(matrix).reshape(count, -1) * share[:, None].astype(np.float32),
        escape=np.array(empty) * share,
        lamp=np.array(lit) * share,
        ray_lamp=_along_rays(tracer, light.lamp, camera.position_mm, depth, direction, seed),
        depth=depth,
        direction=direction,
        lamp_centre=lamp_centre,
    )


def _cells(
    low: NDArray, high: NDArray, shape: tuple[int, int, int]
) -> tuple[tuple[NDArray, ...], NDArray, NDArray]:
    """Centres along the axes, lower corners (v, 3) and sizes (v, 3) of even cells."""
    size = (high - low) / shape
    axes = tuple(low[i] + (np.arange(shape[i]) + 0.5) * size[i] for i in range(3))
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return axes, centres - size / 2, np.broadcast_to(size, centres.shape)


def _columns(values: NDArray) -> list[mi.Float]:
    return [mi.Float(values[:, i].astype(np.float32)) for i in range(3)]


def _from_lamp(tracer: Tracer, lamp: LampSampler, point: mi.Point3f, u: mi.Float, v: mi.Float) -> mi.Float:
    """The lamp's radiance averaged over the sphere, one sample."""
    every = mi.Bool(True)
    _, way, _ = lamp_point(lamp, point, -lamp.normal, u, v, every)
    # facing the sampled point, so that its form factor is a solid angle over pi
    weight, way, _ = lamp_point(lamp, point, dr.normalize(way), u, v, every)
    return dr.select(visible(tracer, point, point + way, weight > 0), weight / 4, 0)


def _along_rays(
    tracer: Tracer, lamp: LampSampler, eye: NDArray, depth: NDArray, direction: NDArray, seed: int
) -> NDArray[np.float64]:
    """(y, x, STEPS) the lamp's mean over the sphere in each part of the way."""
    count = depth.size * STEPS
    lane = dr.arange(mi.UInt32, count)
    pixel, step = lane // STEPS, mi.Float(lane % STEPS)
    toward = dr.gather(mi.Vector3f, mi.Float(direction.astype(np.float32).ravel()), pixel)
    length = dr.gather(mi.Float, mi.Float(depth.astype(np.float32).ravel()), pixel) * (1 / STEPS)
    start = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in eye))
    random = SobolPoints(3, _RAY_SAMPLES, lane, seed)

    def body(i: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        point = start + toward * (length * (step + random.point(i, 0)))
        return i + 1, total + _from_lamp(tracer, lamp, point, random.point(i, 1), random.point(i, 2))

    limit = dr.opaque(mi.UInt32, _RAY_SAMPLES)
    _, total = dr.while_loop(
        (dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), lambda i, _: i < limit, body
    )
    return np.array(total, float).reshape(*depth.shape, STEPS) / _RAY_SAMPLES


def _depth(transport: PatchTransport, back_mm: float) -> tuple[NDArray, NDArray, NDArray]:
    """(y, x) mm to what each pixel sees on average, directions (y, x, 3), and the lamp's centre."""
    camera = transport.camera
    lamp_centre = transport.light.tracer.lamp_triangles.reshape(-1, 3).mean(axis=0)
    rows, columns = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    direction = camera.directions(columns, rows)
    reach = np.linalg.norm(transport.position - camera.position_mm, axis=1)

    def per_pixel(values: NDArray) -> NDArray:
        return np.bincount(transport.pixel, values, minlength=rows.size).reshape(rows.shape)

    on_lamp = np.maximum(transport.covered - per_pixel(transport.coverage), 0)
    beyond = (back_mm - camera.position_mm[2]) / np.maximum(direction[..., 2], 1e-3)
    to_lamp = float(np.linalg.norm(lamp_centre - camera.position_mm))
    depth = per_pixel(transport.coverage * reach) + on_lamp * to_lamp + (1 - transport.covered) * beyond
    return depth, direction, lamp_centre
