"""Rays against a few dozen flat faces inside the compiled kernel, without a tree.

Each face is a convex polygon of one or two triangles. A ray o + t d meets its plane n . p = c at t = (c - n . o) /
(n . d). The point is inside where four linear functions of its two coordinates in the plane are positive: its distances
from the four edges, mm. A triangle has one of its edges twice.

Two kinds of faces need no such functions: those that bound a convex body, as a block, and those on the scene's convex
hull, as the walls of the room; see `convex_bodies`.

All faces are tried one after the other, without branches, so all lanes take the same path. For a few dozen faces this
takes less time than Embree's tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .convex_bodies import ConvexBody, convex_bodies, convex_room, cross

__all__ = ["MOST_FACES", "FlatFaces", "Nearest", "NearestFace", "flat_faces"]

#: Largest number of faces; more are cheaper in a tree.
MOST_FACES = 64

#: Largest distance of one triangle from the plane of another with which it forms one face, mm.
_FLAT_MM = 1e-4

#: Distance by which faces are enlarged beyond their edges, as a part of the scene's size: a few roundings of a
#: coordinate, so that no ray passes between two faces.
_OVERLAP = 1e-6


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest triangle of each lane's ray, as Mitsuba's preliminary intersection."""

    #: Distance in lengths of the ray's direction; infinite without a hit.
    t: mi.Float
    #: Index of the triangle.
    prim_index: mi.UInt32
    #: Barycentric coordinates of its second and third corner.
    prim_uv: mi.Point2f
    #: Whether the ray hits anything.
    valid: mi.Bool

    def is_valid(self) -> mi.Bool:
        return self.valid


@dataclass(frozen=True, eq=False)
class NearestFace(Nearest):
    """The nearest triangle and its face.

    Normal and material are read by the face, without the triangle.
    """

    #: Index of the face; the number of faces without a hit.
    face: mi.UInt32


@dataclass(frozen=True, eq=False)
class FlatFaces:
    """A few flat faces, with two methods of a Mitsuba scene.

    These are `ray_intersect_preliminary` and `ray_test`.
    """

    #: (3 or 4, 3) corners of each of the f faces, mm, counterclockwise seen from the lit side.
    outlines: tuple[NDArray[np.float64], ...]
    #: (f, 5, 4) rows (a, b) of the plane and of four sides: a . p = b on them, a . p > b inside, a of length 1. The
    #: plane's a is the face's normal; triangles have a side twice.
    planes: NDArray[np.float64]
    #: Convex bodies that some faces bound, outwards.
    bodies: tuple[ConvexBody, ...]
    #: The scene's convex hull, if enough of the remaining faces fill sides of it; otherwise None.
    room: ConvexBody | None
    #: Index and 18 numbers of one lane of each face that is neither of a body nor of the room: plane (n, n . p), axes
    #: (u, u . p) and (v, v . p), and two lines (a, b, c) with a u + b v + c >= 0 inside, mm but for directions.
    rows: tuple[tuple[int, tuple[mi.Float, ...]], ...]
    #: For each face, whether it lies on the scene's convex hull.
    hull: tuple[bool, ...]
    #: Distance by which the faces of `rows` extend beyond their edges, mm.
    overlap_mm: float
    #: (f, 4) line (a, b) of each face's diagonal: a . p + b > 0 in its second triangle.
    diagonals: mi.Float
    #: (f, 2) triangles of each face; twice the same for a single triangle.
    triangles: mi.UInt32
    #: (t, 2, 4) rows (a, b) of each triangle's barycentric coordinates a . p + b.
    coordinates: mi.Float

    def ray_intersect_preliminary(
        self, ray: mi.Ray3f, coherent: bool = False, active: mi.Bool | bool = True
    ) -> NearestFace:
        """Nearest face of each lane's ray, in the form of Mitsuba's method of this name.

        Parameters
        ----------
        ray
            One ray per lane.
        coherent
            Not used; Mitsuba's method has it.
        active
            Lanes whose rays are traced.

        Returns
        -------
        NearestFace
            The hits; of several faces at the same distance the first counts.
        """
        nearest = dr.select(mi.Bool(active), ray.maxt, -1.0)
        none = len(self.planes)
        face = dr.full(mi.UInt32, none, 1)
        for index, row in self.rows:
            t, inside = self._plane_hit(row, ray)
            hit = inside & (t > 0) & (t < nearest)
            nearest = dr.select(hit, t, nearest)
            face = dr.select(hit, index, face)
        for body in (*self.bodies, *([self.room] if self.room else [])):
            t, body_face = body.nearest_face(ray, none)
            hit = (body_face < none) & (t < nearest)
            nearest = dr.select(hit, t, nearest)
            face = dr.select(hit, body_face, face)
        valid = face < none
        position = ray(nearest)
        line = dr.gather(mi.Vector4f, self.diagonals, face, valid)
        second = _line(line, position) > 0
        triangle = dr.gather(mi.UInt32, self.triangles, 2 * face + mi.UInt32(second), valid)
        u, v = (dr.gather(mi.Vector4f, self.coordinates, 2 * triangle + i, valid) for i in (0, 1))
        uv = mi.Point2f(*(dr.clip(_line(row, position), 0, 1) for row in (u, v)))
        return NearestFace(dr.select(valid, nearest, dr.inf), triangle, uv, valid, face)

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool | bool = True, enclosed: bool = False) -> mi.Bool:
        """Whether a ray hits any face before its end.

        Parameters
        ----------
        ray
            One ray per lane.
        active
            Lanes whose rays are traced.
        enclosed
            Whether both ends lie within the scene's convex hull. Faces on the hull cannot be between them and are left
            out.

        Returns
        -------
        Bool
            True for a hit.
        """
        blocked = mi.Bool(False)
        for index, row in self.rows:
            if not (enclosed and self.hull[index]):
                t, inside = self._plane_hit(row, ray)
                blocked |= inside & (t > 0) & (t < ray.maxt)
        for body in self.bodies:
            if enclosed and body.closed:
                blocked |= body.occludes(ray)
            else:
                blocked |= self._hits_body(body, ray)
        if self.room and not enclosed:
            blocked |= self._hits_body(self.room, ray)
        return blocked & active

    def _hits_body(self, body: ConvexBody, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray hits a face of a body before its end."""
        t, face = body.nearest_face(ray, len(self.planes))
        return (face < len(self.planes)) & (t < ray.maxt)

    def crossed(self, ray: mi.Ray3f, walls: Sequence[int]) -> list[mi.UInt32]:
        """Faces that a ray within the scene's convex hull would cross if nothing were there.

        Parameters
        ----------
        ray
            One ray per lane, from within the hull.
        walls
            Indices of faces that count as walls, next to those of the room.

        Returns
        -------
        list[UInt32]
            Index of the nearest wall, then for each body that of the face by which the ray enters; the number of faces
            for none.
        """
        none = len(self.planes)
        nearest, wall = mi.Float(dr.inf), mi.UInt32(none)
        for index, row in self.rows:
            if index in walls:
                t, inside = self._plane_hit(row, ray)
                hit = inside & (t > 0) & (t < nearest)
                nearest, wall = dr.select(hit, t, nearest), dr.select(hit, index, wall)
        if self.room:
            exit_face = self.room.exit_face(ray, none)
            wall = dr.select(exit_face < none, exit_face, wall)
        return [wall, *(body.entry_face(ray, none) for body in self.bodies)]

    def _plane_hit(self, row: tuple[mi.Float, ...], ray: mi.Ray3f) -> tuple[mi.Float, mi.Bool]:
        """Distance to a face's plane, and whether the point there is inside the face."""
        normal, along_u, along_v = (mi.Vector3f(*row[i : i + 3]) for i in (0, 4, 8))
        t = (row[3] - dr.dot(normal, ray.o)) * dr.rcp(dr.dot(normal, ray.d))
        position = ray(t)
        u, v = dr.dot(along_u, position) - row[7], dr.dot(along_v, position) - row[11]
        third, fourth = (dr.fma(row[i], u, dr.fma(row[i + 1], v, row[i + 2])) for i in (12, 15))
        return t, dr.minimum(dr.minimum(u, v), dr.minimum(third, fourth)) > -self.overlap_mm


def _line(row: mi.Vector4f, position: mi.Point3f) -> mi.Float:
    """Linear function a . p + b of a position, for a row (a, b)."""
    return dr.fma(row.x, position.x, dr.fma(row.y, position.y, dr.fma(row.z, position.z, row.w)))


def flat_faces(
    vertices: NDArray[np.float64], facet: NDArray[np.int64], among: NDArray[np.float64] | None = None
) -> FlatFaces | None:
    """Faces of triangles for intersection in the kernel.

    Parameters
    ----------
    vertices
        (t, 3, 3) corners, mm.
    facet
        (t,) flat face of each triangle, as of `facets`; triangles of different ones are not joined.
    among
        (k, 3) corners of the whole scene, mm, where it has more than these triangles; None if these are all.

    Returns
    -------
    FlatFaces | None
        The faces; None for more than MOST_FACES.
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
        triangles=device_array(mi.UInt32, [(indices[0], indices[-1]) for _, indices in polygons]),
        coordinates=device_array(mi.Float, _barycentric(vertices)),
    )


def _polygons(
    vertices: NDArray[np.float64], facet: NDArray[np.int64]
) -> list[tuple[NDArray[np.float64], tuple[int, ...]]]:
    """Outlines (3 or 4, 3), counterclockwise, with the indices of their triangles.

    Two triangles in one plane with a common edge are one face if it is convex.
    """
    polygons: list[tuple[NDArray[np.float64], tuple[int, ...]]] = []
    free = list(range(len(vertices)))
    while free:
        first = free.pop(0)
        for second in free:
            outline = _joined(vertices[first], vertices[second]) if facet[first] == facet[second] else None
            if outline is not None:
                free.remove(second)
                polygons.append((outline, (first, second)))
                break
        else:
            polygons.append((vertices[first], (first,)))
    return polygons


def _joined(first: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The convex quadrilateral (4, 3) of two triangles in one plane; None if they form none.

    The triangles must have an edge in common. The diagonal goes from the second to the fourth corner; the first corner
    is of the first triangle alone.
    """
    normal = _normal(first)
    same = np.linalg.norm(first[:, None] - other, axis=2) < _FLAT_MM
    if same.sum() != 2 or np.abs((other - first[0]) @ normal).max() > _FLAT_MM:
        return None
    apex, far = int(np.flatnonzero(~same.any(axis=1))[0]), int(np.flatnonzero(~same.any(axis=0))[0])
    outline = np.array([first[apex], first[(apex + 1) % 3], other[far], first[(apex + 2) % 3]])
    edges = np.roll(outline, -1, axis=0) - outline
    turns = cross(edges, np.roll(edges, -1, axis=0)) @ normal
    return outline if (turns > 0).all() else None


def _normal(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normal of a plane polygon, by its first three corners."""
    normal = cross(outline[1] - outline[0], outline[2] - outline[0])
    return normal / np.linalg.norm(normal)


def _planes(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """(5, 4) rows of a face, as in `FlatFaces.planes`.

    The first corner is on the second and the last row. A triangle has its second side twice.
    """
    normal = _normal(outline)
    edges = np.roll(outline, -1, axis=0) - outline
    inwards = cross(normal, edges / np.linalg.norm(edges, axis=1, keepdims=True))
    sides = [(a, a @ corner) for a, corner in zip(inwards, outline, strict=True)]
    if len(sides) == 3:
        sides.insert(1, sides[1])
    return np.array([[*a, b] for a, b in ((normal, normal @ outline[0]), *sides)])


def _row(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(18,) numbers of a face, as in `FlatFaces.rows`.

    The coordinates u and v are distances from the first and the last side. The distance from another side is linear in
    them, with coefficients by least squares (exact for vectors of one plane).
    """
    plane, first, *others, last = planes
    axes = np.array([first[:3], last[:3]])
    lines = []
    for other in others:
        parts, *_ = np.linalg.lstsq(axes.T, other[:3], rcond=None)
        lines.append([*parts, parts @ (first[3], last[3]) - other[3]])
    return np.concatenate([plane, first, last, np.ravel(lines)])


def _diagonal(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) linear function of the position, positive in the second triangle.

    All 0 for a face of one triangle.
    """
    if len(outline) == 3:
        return np.zeros(4)
    beyond = cross(outline[3] - outline[1], _normal(outline))
    return np.array([*beyond, -beyond @ outline[1]])


def _barycentric(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(t, 2, 4) rows of the barycentric coordinates u and v, by the pseudoinverse.

    They satisfy position = first + u (second - first) + v (third - first) for points in the plane.
    """
    edges = vertices[:, 1:] - vertices[:, :1]
    rows = np.linalg.pinv(edges.transpose(0, 2, 1))
    return np.concatenate([rows, -(rows @ vertices[:, 0, :, None])], axis=2)
