"""Convex bodies among flat faces: blocks, and the room itself.

A convex body is the intersection of half spaces n . p < c. A ray o + t d crosses the plane at t = (c - n . o) /
(n . d), inwards if n . d < 0. It is inside the body between its last crossing inwards and its first crossing outwards,
if these come in this order. So a body of k faces needs k distances and no test of a point in a polygon.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..device import dr, mi

__all__ = ["ConvexBody", "convex_bodies", "convex_room", "cross"]

#: Largest distance at which two corners are one point, or a corner lies in a plane, mm.
_SAME_MM = 1e-4


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a convex body: a plane, and the faces that fill it."""

    #: (n, n . p) of its plane, n the unit normal outwards, in numbers of one lane.
    plane: tuple[mi.Float, ...]
    #: Indices of the faces that fill the side; none for an open side.
    faces: tuple[int, ...]
    #: (a, b) of the edges between its faces, a . p = b on them, in numbers of one lane.
    lines: tuple[tuple[mi.Float, ...], ...]
    #: For each face but the last, its edges: index of the line, and whether the face is where a . p > b.
    pieces: tuple[tuple[tuple[int, bool], ...], ...]

    def face_at(self, position: mi.Point3f) -> mi.UInt32:
        """Face at a position on a side of several faces.

        Parameters
        ----------
        position
            Point on the side, mm.

        Returns
        -------
        UInt32
            Index of the face; the last one where no other contains the point.
        """
        beyond = [dr.dot(mi.Vector3f(*line[:3]), position) > line[3] for line in self.lines]
        result = mi.UInt32(self.faces[-1])
        for face, piece in zip(self.faces, self.pieces, strict=False):
            inside = mi.Bool(True)
            for line, above in piece:
                inside &= beyond[line] if above else ~beyond[line]
            result = dr.select(inside, face, result)
        return result


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A convex body whose faces are among a scene's.

    A side may be open, as the lower one of a block on the floor; it has no face.
    """

    #: All sides, open ones included.
    sides: tuple[Side, ...]
    #: Whether open sides lie on the scene's convex hull, so that no ray from within the hull enters through them.
    closed: bool

    @property
    def faces(self) -> list[int]:
        """Indices of the faces of all sides, rising."""
        return sorted(face for side in self.sides for face in side.faces)

    def nearest_face(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32]:
        """Nearest face of the body on each lane's ray.

        From outside this is the face by which the ray enters. Where it starts inside, or enters through an open side,
        it is the face by which it leaves.

        Parameters
        ----------
        ray
            One ray per lane.
        none
            Index that stands for no face.

        Returns
        -------
        tuple[Float, UInt32]
            Distance in lengths of the direction, and index of the face; `none` where the ray hits no face.
        """
        enter, at_enter, leave, at_leave = self._span(ray, none)
        outside = (enter > 0) & (at_enter != none)
        t, face = dr.select(outside, enter, leave), dr.select(outside, at_enter, at_leave)
        return t, self._piece_face(dr.select((enter <= leave) & (t > 0), face, none), ray(t))

    def entry_face(self, ray: mi.Ray3f, none: int) -> mi.UInt32:
        """Face by which a ray enters the body.

        Parameters
        ----------
        ray
            One ray per lane.
        none
            Index that stands for no face.

        Returns
        -------
        UInt32
            Index of the face; `none` where the ray does not enter, or enters through an open side.
        """
        enter, at_enter, leave, _ = self._span(ray, none)
        return self._piece_face(dr.select((enter <= leave) & (enter > 0), at_enter, none), ray(enter))

    def exit_face(self, ray: mi.Ray3f, none: int) -> mi.UInt32:
        """Face by which a ray leaves the body.

        Parameters
        ----------
        ray
            One ray per lane.
        none
            Index that stands for no face.

        Returns
        -------
        UInt32
            Index of the face; `none` where the ray does not leave, or leaves through an open side.
        """
        enter, _, leave, at_leave = self._span(ray, none)
        return self._piece_face(dr.select((enter <= leave) & (leave > 0), at_leave, none), ray(leave))

    def _piece_face(self, face: mi.UInt32, position: mi.Point3f) -> mi.UInt32:
        """Face at a position, if `face` is the first of a side with several; else `face`."""
        for side in self.sides:
            if len(side.faces) > 1:
                face = dr.select(face == side.faces[0], side.face_at(position), face)
        return face

    def _span(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32, mi.Float, mi.UInt32]:
        """Last plane crossed inwards, first one crossed outwards: distances and first faces."""
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        at_enter, at_leave = mi.UInt32(none), mi.UInt32(none)
        for side in self.sides:
            t, inwards = _plane(side.plane, ray)
            later, sooner = inwards & (t > enter), ~inwards & (t < leave)
            index = mi.UInt32(side.faces[0] if side.faces else none)
            enter, at_enter = dr.select(later, t, enter), dr.select(later, index, at_enter)
            leave, at_leave = dr.select(sooner, t, leave), dr.select(sooner, index, at_leave)
        return enter, at_enter, leave, at_leave

    def occludes(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray hits the body before the ray's end, if it passes no open side.

        Parameters
        ----------
        ray
            One ray per lane.

        Returns
        -------
        Bool
            True for a hit.
        """
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        for side in self.sides:
            t, inwards = _plane(side.plane, ray)
            enter = dr.select(inwards, dr.maximum(enter, t), enter)
            leave = dr.select(inwards, leave, dr.minimum(leave, t))
        nearest = dr.select(enter > 0, enter, leave)
        return (enter <= leave) & (nearest > 0) & (nearest < ray.maxt)


def _plane(row: tuple[mi.Float, ...], ray: mi.Ray3f) -> tuple[mi.Float, mi.Bool]:
    """Distance to a plane along a ray, and whether the ray crosses it inwards.

    Along a plane the distance is infinite. Its sign, and that of the zero, which counts as a direction, then give
    together on which side the ray is.
    """
    normal = mi.Vector3f(*row[:3])
    slowness = dr.rcp(dr.dot(normal, ray.d))
    return (row[3] - dr.dot(normal, ray.o)) * slowness, slowness < 0


def convex_bodies(
    outlines: Sequence[NDArray[np.float64]],
    normals: NDArray[np.float64],
    corners: NDArray[np.float64],
    overlap_mm: float,
) -> tuple[ConvexBody, ...]:
    """Convex bodies that are bounded by some of the faces.

    Faces that share corners form a group. A group is a body if each face lies in a side of the hull of the group's
    corners. The faces of a side must fill it or leave it open, and all normals must point outwards.

    Parameters
    ----------
    outlines
        (k, 3) corners of each of the f faces, mm.
    normals
        (f, 3) unit normals.
    corners
        (n, 3) corners of the whole scene, mm.
    overlap_mm
        Distance by which the planes are moved outwards, so that a ray at an edge passes no gap, mm.

    Returns
    -------
    tuple[ConvexBody, ...]
        The bodies; faces of none of them are left to other tests.
    """
    bodies = []
    for members in _connected(outlines):
        planes = _planes(np.concatenate([outlines[i] for i in members]))
        filled = [_filling(plane, area, outlines, members) for plane, area in planes]
        outwards = all(
            normals[i] @ plane[:3] > 0 for (plane, _), faces in zip(planes, filled, strict=True) for i in faces
        )
        if sorted(i for faces in filled for i in faces) == members and outwards:
            open_sides = [plane for (plane, _), faces in zip(planes, filled, strict=True) if not faces]
            closed = all((corners @ plane[:3] - plane[3]).max() < _SAME_MM for plane in open_sides)
            bodies.append(_body(planes, filled, outlines, overlap_mm, closed))
    return tuple(bodies)


def convex_room(
    outlines: Sequence[NDArray[np.float64]],
    loose: Sequence[int],
    corners: NDArray[np.float64],
    overlap_mm: float,
) -> ConvexBody | None:
    """The convex hull of the scene as a body, with the faces that fill its sides.

    Parameters
    ----------
    outlines
        (k, 3) corners of each face, mm.
    loose
        Indices of the faces that bound no convex body.
    corners
        (n, 3) corners of the whole scene, mm.
    overlap_mm
        Distance by which the planes are moved outwards, mm.

    Returns
    -------
    ConvexBody | None
        The hull; None if at most half as many faces fill sides as the hull has sides, since single faces then take less
        time.
    """
    planes = _planes(corners, most=2 * len(loose))
    filled = [_filling(plane, area, outlines, loose) for plane, area in planes]
    if 2 * sum(map(len, filled)) <= len(planes):
        return None
    return _body(planes, filled, outlines, overlap_mm, closed=False)


def _filling(
    plane: NDArray[np.float64], area: float, outlines: Sequence[NDArray[np.float64]], members: Sequence[int]
) -> tuple[int, ...]:
    """Faces that fill one side of a hull between them; none if they do not.

    `plane` is the side's (n, n . p) and `area` its area, mm^2; only faces among `members` count.
    """
    faces = [i for i in members if np.abs(outlines[i] @ plane[:3] - plane[3]).max() < _SAME_MM]
    fills = abs(sum(_area(outlines[i]) for i in faces) / area - 1) < 1e-6
    return tuple(faces) if fills else ()


def _body(
    planes: Sequence[tuple[NDArray[np.float64], float]],
    filled: Sequence[tuple[int, ...]],
    outlines: Sequence[NDArray[np.float64]],
    overlap_mm: float,
    closed: bool,
) -> ConvexBody:
    """The body of sides with these planes and faces, the planes moved outwards by `overlap_mm`."""
    sides = []
    for (plane, _), faces in zip(planes, filled, strict=True):
        lines, pieces = _division(plane, [outlines[i] for i in faces])
        sides.append(Side(_one_lane([*plane[:3], plane[3] + overlap_mm]), faces, lines, pieces))
    return ConvexBody(tuple(sides), closed)


def _division(
    plane: NDArray[np.float64], outlines: Sequence[NDArray[np.float64]]
) -> tuple[tuple[tuple[mi.Float, ...], ...], tuple[tuple[tuple[int, bool], ...], ...]]:
    """Fields `lines` and `pieces` of a `Side` with faces of these outlines.

    Edges on the border of the side are left out, and edges on a common line are one line.
    """
    corners = np.concatenate(outlines) if outlines else np.empty((0, 3))
    lines: list[NDArray[np.float64]] = []
    pieces = []
    for outline in outlines[:-1]:
        middle, piece = outline.mean(axis=0), []
        for first, second in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            across = cross(plane[:3], second - first)
            line = np.array([*across, across @ first]) / np.linalg.norm(across)
            heights = corners @ line[:3] - line[3]
            if min(heights.max(), -heights.min()) < _SAME_MM:  # at the side's own edge
                continue
            ends = np.array([first, second])
            coincident = [np.abs(ends @ other[:3] - other[3]).max() < _SAME_MM for other in lines]
            if not any(coincident):
                coincident.append(True)
                lines.append(line)
            number = coincident.index(True)
            piece.append((number, bool(middle @ lines[number][:3] > lines[number][3])))
        pieces.append(tuple(piece))
    return tuple(_one_lane(line) for line in lines), tuple(pieces)


def _one_lane(row: Sequence[float] | NDArray[np.float64]) -> tuple[mi.Float, ...]:
    """Numbers of one lane, which are data of the kernel, not literals in it."""
    return tuple(dr.opaque(mi.Float, float(value)) for value in row)


def _connected(outlines: Sequence[NDArray[np.float64]]) -> list[list[int]]:
    """Groups of faces that share corners, as sorted indices."""
    groups: list[list[int]] = []
    for index, outline in enumerate(outlines):
        touching = [
            g for g in groups if any(np.linalg.norm(outlines[i][:, None] - outline, axis=2).min() < _SAME_MM for i in g)
        ]
        groups = [g for g in groups if g not in touching]
        groups.append(sorted([*(i for g in touching for i in g), index]))
    return groups


def _planes(corners: NDArray[np.float64], most: float = np.inf) -> list[tuple[NDArray[np.float64], float]]:
    """Planes (n, n . p), n outwards, of the hull of points (k, 3), with the area in each.

    Empty for points in one plane, and for a hull of more than `most` sides, as of a fine mesh.
    """
    try:
        hull = ConvexHull(corners)
    except QhullError:
        return []
    planes: list[tuple[NDArray[np.float64], float]] = []
    for equation, simplex in zip(hull.equations, hull.simplices, strict=True):
        plane, area = np.array([*equation[:3], -equation[3]]), _area(hull.points[simplex])
        for index, (other, sum_) in enumerate(planes):
            if np.abs(hull.points[simplex] @ other[:3] - other[3]).max() < _SAME_MM and other[:3] @ plane[:3] > 0:
                planes[index] = other, sum_ + area
                break
        else:
            planes.append((plane, area))
        if len(planes) > most:
            return []
    return planes


def cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products of vectors, as of ``np.cross``, in a fifth of its time for a few of them.

    Parameters
    ----------
    first, second
        (3,) or (k, 3) vectors.

    Returns
    -------
    NDArray
        (3,) or (k, 3) products.
    """
    x, y, z = first.T
    u, v, w = second.T
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T


def _area(outline: NDArray[np.float64]) -> float:
    """Area of a plane polygon (k, 3), by the cross products of its corners."""
    return 0.5 * float(np.linalg.norm(cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0)))
