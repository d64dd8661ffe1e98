"""Direct light of a lamp: shadow rays, with a control variate of known mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Lamp

from ..device import device_array, dr, mi, polynomial, polynomial_at
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, visible

__all__ = [
    "LampSampler",
    "angle_over_sine",
    "build_lamp_samplers",
    "direct_light",
    "form_factor",
    "lamp_pattern",
    "lamp_point",
    "lamp_radiance",
    "lamp_seen",
]


#: atan(x) / x as a polynomial in x^2, for 0 <= x <= 1, with an error below 2e-8.
_ARC_TANGENT_RATIO = polynomial(lambda s: np.arctan(np.sqrt(s)) / np.sqrt(s), 8)


@dataclass(frozen=True, eq=False)
class LampSampler:
    """A planar lamp, for sampling by area and for the analytic form factor."""

    #: Index of material of hits on the lamp.
    material: int
    #: Corners of its triangles, three of each, mm.
    corners: list[mi.Point3f]
    #: Cumulative share of the area of the triangles, 0 to 1.
    thresholds: list[float]
    #: Unit normal, on the emitting side.
    normal: mi.Vector3f
    #: Area, mm^2, as data of a kernel, so that lamps of any size share one kernel.
    area: mi.Float
    #: Area over pi, mm^2, in the same way.
    area_over_pi: mi.Float
    #: Whether it is a rectangle along x and z.
    level_rectangle: bool
    #: Edges of its outline, from corner to corner, mm.
    border: list[tuple[mi.Point3f, mi.Point3f]]
    #: (3,) centre of its bounding box, mm.
    centre: np.ndarray
    #: (3,) half sizes of its bounding box, mm.
    half_size: np.ndarray
    #: Radiance at its edges over that at its centre; 1 for an even lamp.
    edge_ratio: float
    #: Exponent n of the radiance cos^n(theta) by the angle from the normal; 0 for a Lambertian lamp.
    exponent: float
    #: Its pattern; None for none.
    cells: _Cells | None
    #: Whether its outline is one convex polygon.
    convex: bool


@dataclass(frozen=True, eq=False)
class _Cells:
    """Pattern of a lamp: factors of its radiance in cells of a rectangle."""

    #: (rows * columns) factors, row by row.
    values: mi.Float
    #: Rows and columns.
    shape: tuple[int, int]
    #: First corner of the lamp, mm.
    corner: mi.Point3f
    #: Edge along which the columns follow each other, mm.
    along_columns: mi.Vector3f
    #: Edge along which the rows follow each other, mm.
    along_rows: mi.Vector3f

    def __call__(self, point: mi.Point3f) -> mi.Float:
        offset = point - self.corner
        cell = []
        for axis, count in ((self.along_rows, self.shape[0]), (self.along_columns, self.shape[1])):
            part = dr.dot(offset, axis) / dr.squared_norm(axis)
            # bounded after the conversion: rays that meet nothing have no point, and NaN passes the first bounds
            cell.append(dr.minimum(mi.UInt32(dr.clip(part * count, 0, count - 1)), count - 1))
        return dr.gather(mi.Float, self.values, cell[0] * self.shape[1] + cell[1])


def _cells(lamp: Lamp) -> _Cells | None:
    """Pattern of a lamp on the device; None for none."""
    if lamp.pattern is None:
        return None
    corner, right, _, up = lamp.surface.vertices_mm[:4]
    edges = (mi.Vector3f(_point(end - corner)) for end in (right, up))
    return _Cells(device_array(mi.Float, lamp.pattern), lamp.pattern.shape, _point(corner), *edges)


def _point(values: np.ndarray) -> mi.Point3f:
    """A point in numbers of one lane, which are data, so that lamps anywhere share one kernel."""
    return mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in values))


def build_lamp_samplers(tracer: Tracer) -> tuple[LampSampler, ...]:
    """Samplers of a scene's lamps.

    Parameters
    ----------
    tracer
        Tracer of the scene, in which each lamp is planar: all its triangles share a normal.

    Returns
    -------
    tuple[LampSampler, ...]
        One sampler for each lamp.
    """
    return tuple(_sampler(tracer, index) for index in range(len(tracer.scene.lamps)))


def _sampler(tracer: Tracer, index: int) -> LampSampler:
    """Sampler of one lamp; the outline has the edges that no two triangles share."""
    triangles = tracer.lamp_triangles(index)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    edges: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}
    for triangle in triangles:
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            if edges.pop((tuple(b), tuple(a)), None) is None:
                edges[tuple(a), tuple(b)] = (a, b)
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    lamp = tracer.scene.lamps[index]
    half_size = np.maximum((high - low) / 2, 1e-9)
    return LampSampler(
        material=len(tracer.material_names) + index,
        corners=[_point(c) for t in triangles for c in t],
        thresholds=list(np.cumsum(areas) / areas.sum()),
        normal=mi.Vector3f(_point(cross[0] / np.linalg.norm(cross[0]))),
        area=dr.opaque(mi.Float, float(areas.sum())),
        area_over_pi=dr.opaque(mi.Float, float(areas.sum()) / np.pi),
        level_rectangle=_level_rectangle(float(areas.sum()), half_size),
        border=[(_point(a), _point(b)) for a, b in edges.values()],
        centre=(low + high) / 2,
        half_size=half_size,
        edge_ratio=lamp.edge_ratio,
        exponent=lamp.exponent,
        cells=_cells(lamp),
        convex=_convex(list(edges.values()), cross[0]),
    )


def _convex(border: list[tuple[np.ndarray, np.ndarray]], normal: np.ndarray) -> bool:
    """Whether edges bound one convex polygon.

    No corner lies outside any edge, and each corner is the start of one edge.
    """
    starts, ends = (np.array(points) for points in zip(*border, strict=True))
    inward = np.cross(normal, ends - starts)
    inside = np.einsum("ek,cek->ce", inward, starts[:, None] - starts[None])
    size = np.ptp(starts, axis=0).max()
    flat = bool(inside.min() >= -1e-6 * np.linalg.norm(inward, axis=1).max() * size)
    return flat and len(np.unique(starts, axis=0)) == len(starts)


def _sample(lamp: LampSampler, u: mi.Float, v: mi.Float) -> mi.Point3f:
    """A point uniform over the lamp's area; `u` also selects the triangle."""
    low, result = 0.0, lamp.corners[0]
    for i, high in enumerate(lamp.thresholds):
        a, b, c = lamp.corners[3 * i : 3 * i + 3]
        root = dr.sqrt((u - low) / (high - low))
        point = a + (b - a) * (root * (1 - v)) + (c - a) * (root * v)
        result = point if i == 0 else dr.select(u >= low, point, result)
        low = high
    return result


def _sample_pattern(lamp: LampSampler, u: mi.Float, v: mi.Float) -> mi.Point3f:
    """A point of a horizontal rectangular lamp, of a density proportional to its radiance.

    The radiance falls from the centre to the edges by the edge ratio e: e + (1 - e) (1 - x^2) (1 - z^2). This is a
    mixture of a uniform density and the product of two parabolas, 3/4 (1 - x^2). The quantile function of a parabola is
    2 sin(arcsin(2 u - 1) / 3).
    """
    e = lamp.edge_ratio
    even = e / (e + (1 - e) * 4 / 9)
    flat = u < even
    first = dr.select(flat, u / max(even, 1e-9), (u - even) / max(1 - even, 1e-9))

    def coordinate(number: mi.Float) -> mi.Float:
        centred = 2 * number - 1
        return dr.select(flat, centred, 2 * dr.sin(dr.asin(dr.clip(centred, -1, 1)) / 3))

    centre, half = (tuple(float(c) for c in row) for row in (lamp.centre, lamp.half_size))
    x, z = centre[0] + half[0] * coordinate(first), centre[2] + half[2] * coordinate(v)
    return mi.Point3f(x, centre[1], z)


def _follows_pattern(lamp: LampSampler) -> bool:
    """Whether `_sample_pattern` applies to a lamp.

    It must have an edge ratio and no cells, and be a horizontal rectangle along x and z.
    """
    return lamp.level_rectangle and lamp.cells is None and lamp.edge_ratio != 1.0


def _level_rectangle(area: float, half_size: np.ndarray) -> bool:
    """Whether an area, mm^2, fills its bounding box along x and z, of half sizes in mm."""
    return bool(half_size[1] <= 1e-6 and abs(area / (4 * half_size[0] * half_size[2]) - 1) < 1e-6)


def _unoccluded(lamp: LampSampler, position: mi.Point3f, normal: mi.Vector3f) -> tuple[mi.Float, mi.Bool]:
    """Form factor from a point to the lamp above its horizon, and whether it is valid.

    It is valid for a convex lamp, and for others if all their corners lie above the horizon.
    """
    if lamp.convex:
        return form_factor(lamp.border, position, normal), mi.Bool(True)
    valid = mi.Bool(True)
    for start, _ in lamp.border:
        valid &= dr.dot(start - position, normal) > 0
    return form_factor(lamp.border, position, normal), valid


def form_factor(border: list[tuple[mi.Point3f, mi.Point3f]], position: mi.Point3f, normal: mi.Vector3f) -> mi.Float:
    """Form factor from a point to the part of a convex polygon above its horizon.

    Lambert's formula: 1 / (2 pi) |Sum over edges of (angle that the edge spans) (n . g)|, where g is the unit normal of
    the plane through the point and the edge, and n that of the surface. The part below the horizon is cut off; the ends
    of the cut are joined by an edge in the horizon, which counts like any other.

    Parameters
    ----------
    border
        Edges of the polygon, from corner to corner, mm.
    position
        Point of each lane, mm.
    normal
        Unit normal of the surface there.

    Returns
    -------
    Float
        Irradiance over pi times the polygon's radiance, 0 to 1.
    """
    total = mi.Float(0)
    leaving, entering = mi.Vector3f(0), mi.Vector3f(0)
    for start, end in border:
        a, b = mi.Vector3f(start - position), mi.Vector3f(end - position)
        above_a, above_b = dr.dot(a, normal), dr.dot(b, normal)
        crossing = (above_a > 0) != (above_b > 0)
        cut = a + (b - a) * (above_a / dr.select(crossing, above_a - above_b, 1))
        leaving = dr.select(crossing & (above_a > 0), cut, leaving)
        entering = dr.select(crossing & (above_b > 0), cut, entering)
        total += _edge_share(
            dr.select(above_a > 0, a, cut), dr.select(above_b > 0, b, cut), normal, (above_a > 0) | (above_b > 0)
        )
    total += _edge_share(leaving, entering, normal, mi.Bool(True))
    return dr.abs(total) * (0.5 / np.pi)


def _edge_share(a: mi.Vector3f, b: mi.Vector3f, normal: mi.Vector3f, active: mi.Bool) -> mi.Float:
    """Term of one edge in Lambert's formula.

    It is the angle that the edge spans, times the cosine between its plane and the horizon.
    """
    axis = dr.cross(a, b)
    return dr.select(active, dr.dot(axis, normal) * angle_over_sine(dr.norm(axis), dr.dot(a, b)), 0)


def angle_over_sine(sine: mi.Float, cosine: mi.Float) -> mi.Float:
    """Angle of given sine and cosine, over its sine, with a single division.

    Parameters
    ----------
    sine
        Sine times any length, >= 0.
    cosine
        Cosine times the same length.

    Returns
    -------
    Float
        atan2(sine, cosine) / sine; finite if both are 0.
    """
    sine = dr.select(sine > 1e-12, sine, 1e-12)
    base = dr.abs(cosine)
    steep = base < sine
    longer, shorter = dr.select(steep, sine, base), dr.select(steep, base, sine)
    inverse = dr.rcp(longer * sine)
    ratio = shorter * sine * inverse
    angle = ratio * polynomial_at(_ARC_TANGENT_RATIO, ratio * ratio)
    angle = dr.select(steep, 0.5 * np.pi - angle, angle)
    return dr.select(cosine < 0, np.pi - angle, angle) * longer * inverse


def lamp_pattern(lamp: LampSampler, point: mi.Point3f, cosine: mi.Float) -> mi.Float | float:
    """Radiance of a lamp, relative to its mean along its normal.

    Parameters
    ----------
    lamp
        The lamp.
    point
        Point on it, mm.
    cosine
        Cosine of the angle between the direction and its normal.

    Returns
    -------
    Float | float
        Relative radiance; 1 for a lamp without any pattern.
    """
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


def lamp_seen(lamp: LampSampler, hit: Hit, direction: mi.Vector3f) -> mi.Float:
    """Radiance of a lamp at hits of rays, relative to its mean along its normal.

    Parameters
    ----------
    lamp
        The lamp.
    hit
        The hits.
    direction
        Unit directions of the rays.

    Returns
    -------
    Float
        Relative radiance; 0 for hits of anything else.
    """
    pattern = lamp_pattern(lamp, hit.position, -dr.dot(direction, lamp.normal))
    return dr.select(hit.on_lamp & (hit.material == lamp.material), pattern, mi.Float(0))


def direct_light(
    tracer: Tracer,
    lamp: LampSampler,
    position: mi.Point3f,
    normal: mi.Vector3f,
    u: mi.Float,
    v: mi.Float,
    active: mi.Bool,
) -> mi.Float:
    """Direct light of a lamp by one shadow ray, as a form factor.

    Unbiased. The pattern of a rectangular lamp with an edge ratio is importance sampled. Otherwise the unoccluded form
    factor w of the lamp point has the analytic mean w0, used as a control variate: the estimate is w V + (w0 - w) with
    the visibility V. Points that see all of the lamp above their horizon then have no sampling noise, also points of a
    wall that the lamp touches.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    lamp
        The lamp.
    position
        Points on surfaces of the scene, mm.
    normal
        Unit normals there.
    u
        First random number for the point of the lamp, in [0, 1).
    v
        Second random number, in [0, 1).
    active
        Lanes that are evaluated.

    Returns
    -------
    Float
        Irradiance over pi times the lamp's mean radiance along its normal; 0 in other lanes. Single estimates may be
        negative.
    """
    origin = position + normal * RAY_OFFSET_MM
    if _follows_pattern(lamp):
        # with the pattern as density, the remaining integrand hardly varies over the lamp
        offset = _sample_pattern(lamp, u, v) - origin
        square = dr.squared_norm(offset)
        direction = offset * dr.rsqrt(square)
        cosine, lamp_cosine = dr.dot(direction, normal), -dr.dot(direction, lamp.normal)
        facing = active & (cosine > 0) & (lamp_cosine > 0)
        weight = cosine * lamp_cosine * lamp.area / (np.pi * square)
        weight *= dr.power(lamp_cosine, lamp.exponent) if lamp.exponent else 1
        return dr.select(visible(tracer, origin, origin + offset, facing, enclosed=True), weight, 0)
    weight, offset, _ = lamp_point(lamp, origin, normal, u, v, active, patterned=False)
    direction = dr.normalize(offset)
    point = origin + offset
    free = visible(tracer, origin, point, active & (weight > 0), enclosed=True)
    sampled = dr.select(free, weight * lamp_pattern(lamp, point, -dr.dot(direction, lamp.normal)), 0)
    mean, valid = _unoccluded(lamp, origin, normal)
    in_front = dr.dot(origin - point, lamp.normal) > 0
    return dr.select(active, sampled + dr.select(valid & in_front, mean - weight, 0), 0)


def lamp_point(
    lamp: LampSampler,
    origin: mi.Point3f,
    normal: mi.Vector3f,
    u: mi.Float,
    v: mi.Float,
    active: mi.Bool,
    patterned: bool = True,
) -> tuple[mi.Float, mi.Vector3f, mi.Float]:
    """Form factor of one point of the lamp, without a test of visibility.

    Parameters
    ----------
    lamp
        The lamp.
    origin
        Points from which the lamp is seen, mm.
    normal
        Unit normals there.
    u
        First random number for the point of the lamp, in [0, 1).
    v
        Second random number, in [0, 1).
    active
        Lanes that are evaluated.
    patterned
        Whether the form factor includes the lamp's pattern.

    Returns
    -------
    tuple[Float, Vector3f, Float]
        Irradiance over pi times radiance; the vector to the point, mm; and the density of its direction, 1/sr, of
        points uniform over the area. The first and the last are 0 where the two sides do not face each other.
    """
    point = _sample(lamp, u, v)
    offset = point - origin
    square = dr.squared_norm(offset)
    nearness = dr.rsqrt(square)
    direction = offset * nearness
    cosine = dr.dot(direction, normal)
    lamp_cosine = -dr.dot(direction, lamp.normal)
    facing = active & (cosine > 0) & (lamp_cosine > 0)
    weight = dr.select(facing, cosine * lamp_cosine * (nearness * nearness) * lamp.area_over_pi, 0)
    if patterned:
        weight = dr.select(facing, weight * lamp_pattern(lamp, point, lamp_cosine), 0)
    return weight, offset, dr.select(facing, square / (lamp.area * lamp_cosine), 0)


def lamp_radiance(
    lamp: LampSampler, origin: mi.Point3f, u: mi.Float, v: mi.Float
) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Float]:
    """Radiance from one point of the lamp, without a test of visibility.

    Parameters
    ----------
    lamp
        The lamp.
    origin
        Points from which the lamp is seen, mm.
    u
        First random number for the point of the lamp, in [0, 1).
    v
        Second random number, in [0, 1).

    Returns
    -------
    tuple[Vector3f, Float, Float, Float]
        Unit direction to the point; distance, mm; density of the direction, 1/sr, of points uniform over the area; and
        radiance relative to the lamp's mean. The last two are 0 behind the lamp.
    """
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
