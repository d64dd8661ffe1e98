"""Rays against a few dozen flat faces inside the compiled kernel, without a tree.

Each face is a convex polygon of one or two triangles. A ray meets its plane at t; the point is inside where four
linear functions of its two coordinates in the plane, distances from the edges in mm, are positive. Faces that bound a
convex body, as a block or the room, need no such functions, see ``convex_bodies``. All faces are tried one after the
other, without branches: for a few dozen that takes less time than Embree's tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .convex_bodies import ConvexBody, convex_bodies, convex_room

__all__ = ["MOST_FACES", "FlatFaces", "Nearest", "NearestFace", "flat_faces"]

#: More faces than this are cheaper in a tree.
MOST_FACES = 64

#: Two triangles are one face where the second lies in the plane of the first within this, mm.
_FLAT_MM = 1e-4

#: Faces reach this part of the scene's size further than their edges, so that no ray passes between two of them. It
#: is a few roundings of a coordinate.
_OVERLAP = 1e-6


@dataclass(frozen=True, eq=False)
class Nearest:
    """What Mitsuba's preliminary intersection tells: t, infinite for none, the triangle, barycentric coordinates."""

    t: mi.Float
    prim_index: mi.UInt32
    prim_uv: mi.Point2f
    valid: mi.Bool

    def is_valid(self) -> mi.Bool:
        return self.valid


@dataclass(frozen=True, eq=False)
class NearestFace(Nearest):
    """Also tells the face, whose normal and material need no triangle."""

    face: mi.UInt32


@dataclass(frozen=True, eq=False)
class FlatFaces:
    """Faces for ``ray_intersect_preliminary`` and ``ray_test``, which answer as Mitsuba's scene does.

    outlines : (3 or 4, 3) corners of each face, mm, counterclockwise seen from the lit side.
    planes : (f, 5, 4) rows (a, b) of the plane and of four sides, a . p = b on them, a . p > b inside, a of length 1;
    the plane's a is the face's normal. Triangles have a side twice. bodies : of the faces that bound convex ones,
    outwards. room : of those that fill sides of the scene's convex hull; None where they are few.
    rows : of each other face its index and 18 numbers of one lane: plane (n, n . p), axes (u, u . p), (v, v . p), and
    two lines (a, b, c) with a u + b v + c >= 0 inside, mm but for directions. hull : for each face, whether it lies on
    the scene's convex hull. overlap_mm : how far faces of ``rows`` reach beyond edges. triangles : (f, 2) of each face,
    the second where the diagonal's line, a row (f, 4) of the position, is positive. coordinates : (t, 2, 4) rows of
    barycentric coordinates.
    """

    outlines: tuple[NDArray[np.float64], ...]
    planes: NDArray[np.float64]
    bodies: tuple[ConvexBody, ...]
    room: ConvexBody | None
    rows: tuple[tuple[int, tuple[mi.Float, ...]], ...]
    hull: tuple[bool, ...]
    overlap_mm: float
    diagonals: mi.Float
    triangles: mi.UInt32
    coordinates: mi.Float

    def ray_intersect_preliminary(
        self, ray: mi.Ray3f, coherent: bool = False, active: mi.Bool | bool = True
    ) -> NearestFace:
        """The nearest face of each lane's ray; of one at the same distance as another the first."""
        nearest = dr.select(mi.Bool(active), ray.maxt, -1.0)
        none = len(self.planes)
        face = dr.full(mi.UInt32, none, 1)
        for index, row in self.rows:
            t, inside = self._met(row, ray)
            hit = inside & (t > 0) & (t < nearest)
            nearest = dr.select(hit, t, nearest)
            face = dr.select(hit, index, face)
        for body in (*self.bodies, *([self.room] if self.room else [])):
            t, own = body.met(ray, none)
            hit = (own < none) & (t < nearest)
            nearest = dr.select(hit, t, nearest)
            face = dr.select(hit, own, face)
        valid = face < none
        position = ray(nearest)
        line = dr.gather(mi.Vector4f, self.diagonals, face, valid)
        second = _line(line, position) > 0
        triangle = dr.gather(mi.UInt32, self.triangles, 2 * face + mi.UInt32(second), valid)
        u, v = (dr.gather(mi.Vector4f, self.coordinates, 2 * triangle + i, valid) for i in (0, 1))
        uv = mi.Point2f(*(dr.clip(_line(row, position), 0, 1) for row in (u, v)))
        return NearestFace(dr.select(valid, nearest, dr.inf), triangle, uv, valid, face)

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool | bool = True, enclosed: bool = False) -> mi.Bool:
        """Whether any face is met before the ray's end.

        enclosed : both ends lie within the scene's convex hull, whose faces then cannot be between them.
        """
        blocked = mi.Bool(False)
        for index, row in self.rows:
            if not (enclosed and self.hull[index]):
                t, inside = self._met(row, ray)
                blocked |= inside & (t > 0) & (t < ray.maxt)
        for body in self.bodies:
            if enclosed and body.shut:
                blocked |= body.blocks(ray)
            else:
                blocked |= self._met_by(body, ray)
        if self.room and not enclosed:
            blocked |= self._met_by(self.room, ray)
        return blocked & active

    def _met_by(self, body: ConvexBody, ray: mi.Ray3f) -> mi.Bool:
        t, own = body.met(ray, len(self.planes))
        return (own < len(self.planes)) & (t < ray.maxt)

    def crossed(self, ray: mi.Ray3f, walls: Sequence[int]) -> list[mi.UInt32]:
        """Faces that a ray from within the scene's convex hull would cross if nothing else were there: the nearest of
        ``walls`` or of the room, then for each body that by which it enters. Indices of faces; their number for none.
        """
        none = len(self.planes)
        nearest, wall = mi.Float(dr.inf), mi.UInt32(none)
        for index, row in self.rows:
            if index in walls:
                t, inside = self._met(row, ray)
                hit = inside & (t > 0) & (t < nearest)
                nearest, wall = dr.select(hit, t, nearest), dr.select(hit, index, wall)
        if self.room:
            left = self.room.left(ray, none)
            wall = dr.select(left < none, left, wall)
        return [wall, *(body.entered(ray, none) for body in self.bodies)]

    def _met(self, row: tuple[mi.Float, ...], ray: mi.Ray3f) -> tuple[mi.Float, mi.Bool]:
        """Distance to a face's plane, and whether the point there is inside the face."""
        normal, along_u, along_v = (mi.Vector3f(*row[i : i + 3]) for i in (0, 4, 8))
        t = (row[3] - dr.dot(normal, ray.o)) * dr.rcp(dr.dot(normal, ray.d))
        position = ray(t)
        u, v = dr.dot(along_u, position) - row[7], dr.dot(along_v, position) - row[11]
        third, fourth = (dr.fma(row[i], u, dr.fma(row[i + 1], v, row[i + 2])) for i in (12, 15))
        return t, dr.minimum(dr.minimum(u, v), dr.minimum(third, fourth)) > -self.overlap_mm


def _line(row: mi.Vector4f, position: mi.Point3f) -> mi.Float:
    return dr.fma(row.x, position.x, dr.fma(row.y, position.y, dr.fma(row.z, position.z, row.w)))


def flat_faces(
    vertices: NDArray[np.float64], facet: NDArray[np.int64], among: NDArray[np.float64] | None = None
) -> FlatFaces | None:
    """The faces of triangles (t, 3, 3) in mm, by flat face ``facet`` (t,); None for more than MOST_FACES.

    among : (k, 3) corners of the whole scene, where there is more than these triangles.
    """
    if len(vertices) > 2 * MOST_FACES:
        return None
    polygons = _polygons(vertices, facet)
    if len(polygons) > MOST_FACES:
        return None
    corners = vertices.reshape(-1, 3) if among is None else among
    planes = np.array([_planes(outline) for outline, _ in polygons])
    height = corners @ planes[:, 0, :3].T - planes[:, 0, 3]
    overlap_mm = _OVERLAP * float(np.ptp(corners, axis=0).max())
    outlines = tuple(outline for outline, _ in polygons)
    bodies = convex_bodies(outlines, planes[:, 0, :3], corners, overlap_mm)
    loose = sorted({*range(len(polygons))}.difference(*(body.faces for body in bodies)))
    room = convex_room(outlines, loose, corners, overlap_mm)
    if room:
        loose = [index for index in loose if index not in room.faces]
    return FlatFaces(
        outlines=outlines,
        planes=planes,
        bodies=bodies,
        room=room,
        rows=tuple((i, tuple(dr.opaque(mi.Float, float(value)) for value in _row(planes[i]))) for i in loose),
        hull=tuple(bool(h) for h in np.minimum(height.max(axis=0), -height.min(axis=0)) < _FLAT_MM),
        overlap_mm=overlap_mm,
        diagonals=device_array(mi.Float, [_diagonal(outline) for outline, _ in polygons]),
        triangles=device_array(mi.UInt32, [(own[0], own[-1]) for _, own in polygons]),
        coordinates=device_array(mi.Float, _barycentric(vertices)),
    )


def _polygons(
    vertices: NDArray[np.float64], facet: NDArray[np.int64]
) -> list[tuple[NDArray[np.float64], tuple[int, ...]]]:
    """Outlines (3 or 4, 3), counterclockwise, with their triangles: two in one plane are one face if it is convex."""
    found: list[tuple[NDArray[np.float64], tuple[int, ...]]] = []
    free = list(range(len(vertices)))
    while free:
        first = free.pop(0)
        for second in free:
            outline = _joined(vertices[first], vertices[second]) if facet[first] == facet[second] else None
            if outline is not None:
                free.remove(second)
                found.append((outline, (first, second)))
                break
        else:
            found.append((vertices[first], (first,)))
    return found


def _joined(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The convex quadrilateral (4, 3) of two triangles in one plane with an edge in common, else None.

    The diagonal goes from its second to its fourth corner; the first corner is of the first triangle alone.
    """
    normal = _normal(one)
    same = np.linalg.norm(one[:, None] - other, axis=2) < _FLAT_MM
    if same.sum() != 2 or np.abs((other - one[0]) @ normal).max() > _FLAT_MM:
        return None
    apex, far = int(np.flatnonzero(~same.any(axis=1))[0]), int(np.flatnonzero(~same.any(axis=0))[0])
    outline = np.array([one[apex], one[(apex + 1) % 3], other[far], one[(apex + 2) % 3]])
    edges = np.roll(outline, -1, axis=0) - outline
    turns = np.cross(edges, np.roll(edges, -1, axis=0)) @ normal
    return outline if (turns > 0).all() else None


def _normal(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    normal = np.cross(outline[1] - outline[0], outline[2] - outline[0])
    return normal / np.linalg.norm(normal)


def _planes(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """(5, 4) rows of a face, as in ``FlatFaces.planes``; the second and the last side have the first corner."""
    normal = _normal(outline)
    edges = np.roll(outline, -1, axis=0) - outline
    inwards = np.cross(normal, edges / np.linalg.norm(edges, axis=1, keepdims=True))
    sides = [(a, a @ corner) for a, corner in zip(inwards, outline, strict=True)]
    if len(sides) == 3:
        sides.insert(1, sides[1])
    return np.array([[*a, b] for a, b in ((normal, normal @ outline[0]), *sides)])


def _row(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(18,) numbers of a face, as in ``FlatFaces.rows``: u and v are distances from its first and its last side."""
    plane, first, *others, last = planes
    axes = np.array([first[:3], last[:3]])
    lines = []
    for other in others:
        parts, *_ = np.linalg.lstsq(axes.T, other[:3], rcond=None)
        lines.append([*parts, parts @ (first[3], last[3]) - other[3]])
    return np.concatenate([plane, first, last, np.ravel(lines)])


def _diagonal(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) of the position: positive beyond the diagonal, in the second triangle; 0 for a face of one triangle."""
    if len(outline) == 3:
        return np.zeros(4)
    beyond = np.cross(outline[3] - outline[1], _normal(outline))
    return np.array([*beyond, -beyond @ outline[1]])


def _barycentric(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(t, 2, 4) rows of u and v with position = first + u (second - first) + v (third - first)."""
    edges = vertices[:, 1:] - vertices[:, :1]
    rows = np.linalg.pinv(edges.transpose(0, 2, 1))
    return np.concatenate([rows, -(rows @ vertices[:, 0, :, None])], axis=2)
