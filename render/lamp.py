"""Direct light from the lamp at a point: sampled shadow rays around the analytic unoccluded value."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.scene import Lamp

from .polynomials import polynomial, polynomial_at
from .tracer import RAY_OFFSET_MM, Tracer, visible

__all__ = ["LampSampler", "build_lamp_sampler", "direct_light", "lamp_pattern", "lamp_point", "lamp_radiance"]


#: atan(x) / x as a polynomial in x^2, for 0 <= x <= 1: off by less than 2e-8.
_ARC_TANGENT = polynomial(lambda s: np.arctan(np.sqrt(s)) / np.sqrt(s), 8)


@dataclass(frozen=True, eq=False)
class LampSampler:
    """The lamp's triangles, ready for sampling by area, and the loop of its border for the analytic value."""

    corners: list[mi.Point3f]
    thresholds: list[float]
    normal: mi.Vector3f
    area: float
    border: list[tuple[mi.Point3f, mi.Point3f]]
    centre: np.ndarray
    half_size: np.ndarray
    edge_ratio: float
    exponent: float
    cells: _Cells | None


@dataclass(frozen=True, eq=False)
class _Cells:
    """The lamp's pattern: values row by row, and the corner and edges along which they lie."""

    values: mi.Float
    shape: tuple[int, int]
    corner: mi.Point3f
    along_columns: mi.Vector3f
    along_rows: mi.Vector3f

    def __call__(self, point: mi.Point3f) -> mi.Float:
        offset = point - self.corner
        places = []
        for axis, count in ((self.along_rows, self.shape[0]), (self.along_columns, self.shape[1])):
            part = dr.dot(offset, axis) / dr.squared_norm(axis)
            places.append(mi.UInt32(dr.clip(part * count, 0, count - 1)))
        return dr.gather(mi.Float, self.values, places[0] * self.shape[1] + places[1])


def _cells(lamp: Lamp) -> _Cells | None:
    if lamp.pattern is None:
        return None
    corner, right, _, up = lamp.surface.vertices_mm[:4]
    edges = (mi.Vector3f(*(float(x) for x in end - corner)) for end in (right, up))
    return _Cells(
        mi.Float(lamp.pattern.astype(np.float32).ravel()), lamp.pattern.shape, _point(corner), *edges
    )


def _point(values: np.ndarray) -> mi.Point3f:
    return mi.Point3f(*(float(x) for x in values))


def build_lamp_sampler(tracer: Tracer) -> LampSampler:
    """Pack the lamp of a scene. The lamp is planar: all its triangles share a normal."""
    triangles = tracer.lamp_triangles
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    edges: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}
    for triangle in triangles:
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            if edges.pop((tuple(b), tuple(a)), None) is None:
                edges[tuple(a), tuple(b)] = (a, b)
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    lamp = tracer.scene.lamp
    return LampSampler(
        corners=[_point(c) for t in triangles for c in t],
        thresholds=list(np.cumsum(areas) / areas.sum()),
        normal=mi.Vector3f(*(float(x) for x in cross[0] / np.linalg.norm(cross[0]))),
        area=float(areas.sum()),
        border=[(_point(a), _point(b)) for a, b in edges.values()],
        centre=(low + high) / 2,
        half_size=np.maximum((high - low) / 2, 1e-9),
        edge_ratio=lamp.edge_ratio,
        exponent=lamp.exponent,
        cells=_cells(lamp),
    )


def _sample(lamp: LampSampler, u: mi.Float, v: mi.Float) -> mi.Point3f:
    """A point uniform over the lamp's area."""
    low, result = 0.0, None
    for i, high in enumerate(lamp.thresholds):
        a, b, c = lamp.corners[3 * i : 3 * i + 3]
        root = dr.sqrt((u - low) / (high - low))
        point = a + (b - a) * (root * (1 - v)) + (c - a) * (root * v)
        result = point if result is None else dr.select(u >= low, point, result)
        low = high
    assert result is not None
    return result


def _sample_pattern(lamp: LampSampler, u: mi.Float, v: mi.Float) -> mi.Point3f:
    """A point of an upright-facing rectangular lamp with the density of its own pattern.

    A mixture of an even density and the product of two parabolas, 3/4 (1 - x^2), whose quantile is
    2 sin(arcsin(2 u - 1) / 3).
    """
    e = lamp.edge_ratio
    even = e / (e + (1 - e) * 4 / 9)
    flat = u < even
    first = dr.select(flat, u / max(even, 1e-9), (u - even) / max(1 - even, 1e-9))

    def place(number: mi.Float) -> mi.Float:
        centred = 2 * number - 1
        return dr.select(flat, centred, 2 * dr.sin(dr.asin(dr.clip(centred, -1, 1)) / 3))

    centre, half = (tuple(float(c) for c in row) for row in (lamp.centre, lamp.half_size))
    x, z = centre[0] + half[0] * place(first), centre[2] + half[2] * place(v)
    return mi.Point3f(x, centre[1], z)


def _follows_pattern(lamp: LampSampler) -> bool:
    """Whether the lamp is uneven, level and a rectangle along x and z: its pattern can then be sampled."""
    level = lamp.half_size[1] <= 1e-6
    return bool(
        level
        and lamp.cells is None
        and lamp.edge_ratio != 1.0
        and abs(lamp.area / (4 * lamp.half_size[0] * lamp.half_size[2]) - 1) < 1e-6
    )


def _unoccluded(lamp: LampSampler, position: mi.Point3f, normal: mi.Vector3f) -> tuple[mi.Float, mi.Bool]:
    """Form factor from a point to the whole lamp by Lambert's formula, and where it holds.

    It holds where every corner of the lamp lies above the point's horizon.
    """
    total = mi.Float(0)
    whole = mi.Bool(True)
    for start, end in lamp.border:
        a, b = start - position, end - position
        whole &= dr.dot(a, normal) > 0
        axis = dr.cross(a, b)
        total += dr.dot(axis, normal) * _angle_over_sine(dr.norm(axis), dr.dot(a, b))
    return dr.abs(total) * (0.5 / np.pi), whole


def _angle_over_sine(sine: mi.Float, cosine: mi.Float) -> mi.Float:
    """atan2(sine, cosine) / sine for sine >= 0: with one division in all, and finite where both are 0."""
    sine = dr.select(sine > 1e-12, sine, 1e-12)
    base = dr.abs(cosine)
    steep = base < sine
    longer, shorter = dr.select(steep, sine, base), dr.select(steep, base, sine)
    inverse = dr.rcp(longer * sine)
    ratio = shorter * sine * inverse
    angle = ratio * polynomial_at(_ARC_TANGENT, ratio * ratio)
    angle = dr.select(steep, 0.5 * np.pi - angle, angle)
    return dr.select(cosine < 0, np.pi - angle, angle) * longer * inverse


def lamp_pattern(lamp: LampSampler, point: mi.Point3f, cosine: mi.Float) -> mi.Float | float:
    """Radiance at a lamp point towards an angle, relative to the lamp's mean along its normal."""
    value: mi.Float | float = 1.0
    if lamp.edge_ratio != 1.0:
        x = (point.x - lamp.centre[0]) / lamp.half_size[0]
        z = (point.z - lamp.centre[2]) / lamp.half_size[2]
        e = lamp.edge_ratio
        value = (e + (1 - e) * (1 - x * x) * (1 - z * z)) / (e + (1 - e) * 4 / 9)
    if lamp.exponent != 0.0:
        value = value * dr.power(cosine, lamp.exponent)
    if lamp.cells is not None:
        value = value * lamp.cells(point)
    return value


def direct_light(
    tracer: Tracer,
    lamp: LampSampler,
    position: mi.Point3f,
    normal: mi.Vector3f,
    u: mi.Float,
    v: mi.Float,
    active: mi.Bool,
) -> mi.Float:
    """Irradiance from the lamp over pi times the lamp's radiance (a form factor, 0 to 1), one shadow ray.

    Unbiased. A rectangular lamp's uneven pattern is sampled as it is. Else the unoccluded
    form factor w of one lamp point has the analytic mean w0, which serves as a
    control variate, w V + (w0 - w), so fully lit points carry no sampling noise.
    """
    origin = position + normal * RAY_OFFSET_MM
    if _follows_pattern(lamp):
        # the pattern as density: what is left to sample hardly varies over the lamp
        offset = _sample_pattern(lamp, u, v) - origin
        square = dr.squared_norm(offset)
        direction = offset * dr.rsqrt(square)
        cosine, lamp_cosine = dr.dot(direction, normal), -dr.dot(direction, lamp.normal)
        facing = active & (cosine > 0) & (lamp_cosine > 0)
        weight = cosine * lamp_cosine * lamp.area / (np.pi * square)
        weight *= dr.power(lamp_cosine, lamp.exponent) if lamp.exponent else 1
        return dr.select(visible(tracer, origin, origin + offset, facing), weight, 0)
    weight, offset, _ = lamp_point(lamp, origin, normal, u, v, active, patterned=False)
    direction = dr.normalize(offset)
    point = origin + offset
    free = visible(tracer, origin, point, active & (weight > 0))
    sampled = dr.select(free, weight * lamp_pattern(lamp, point, -dr.dot(direction, lamp.normal)), 0)
    mean, whole = _unoccluded(lamp, origin, normal)
    in_front = dr.dot(origin - point, lamp.normal) > 0
    return dr.select(active, sampled + dr.select(whole & in_front, mean - weight, 0), 0)


def lamp_point(
    lamp: LampSampler,
    origin: mi.Point3f,
    normal: mi.Vector3f,
    u: mi.Float,
    v: mi.Float,
    active: mi.Bool,
    patterned: bool = True,
) -> tuple[mi.Float, mi.Vector3f, mi.Float]:
    """One point of the lamp, uniform over its area, as seen from ``origin``; nothing is tested for occlusion.

    Returns its form factor (irradiance over pi times radiance; times the lamp's pattern if ``patterned``),
    the way to it in mm, and the probability per steradian of its direction.
    """
    point = _sample(lamp, u, v)
    offset = point - origin
    square = dr.squared_norm(offset)
    nearness = dr.rsqrt(square)
    direction = offset * nearness
    cosine = dr.dot(direction, normal)
    lamp_cosine = -dr.dot(direction, lamp.normal)
    facing = active & (cosine > 0) & (lamp_cosine > 0)
    weight = dr.select(facing, cosine * lamp_cosine * (nearness * nearness) * (lamp.area / np.pi), 0)
    if patterned:
        weight = dr.select(facing, weight * lamp_pattern(lamp, point, lamp_cosine), 0)
    return weight, offset, dr.select(facing, square / (lamp.area * lamp_cosine), 0)


def lamp_radiance(
    lamp: LampSampler, origin: mi.Point3f, u: mi.Float, v: mi.Float
) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Float]:
    """One point of the lamp, uniform over its area: unit direction to it, distance in mm, the probability per
    steradian of the direction (0 behind the lamp), and the radiance from there over the lamp's mean."""
    offset = _sample(lamp, u, v) - origin
    distance = dr.norm(offset)
    direction = offset / distance
    cosine = -dr.dot(direction, lamp.normal)
    facing = cosine > 0
    pattern = lamp_pattern(lamp, origin + offset, cosine)
    return (
        direction,
        distance,
        dr.select(facing, dr.square(distance) / (lamp.area * cosine), 0),
        dr.select(facing, pattern, mi.Float(0)),
    )
