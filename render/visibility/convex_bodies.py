"""Blocks and the room among flat faces: rays meet a convex body where they enter the last of its planes, or leave the
first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..device import dr, mi

__all__ = ["ConvexBody", "convex_bodies", "convex_room"]

#: Corners are one point, and lie in one plane, within this, mm.
_SAME_MM = 1e-4


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a convex body.

    row : (n, n . p) of its plane, n outwards, in numbers of one lane. faces : those that fill it; none for an open
    side. lines : (a, b) of the edges between its faces, as rows. pieces : for each face but the last, which lines it
    lies at, and whether where a . p > b.
    """

    row: tuple[mi.Float, ...]
    faces: tuple[int, ...]
    lines: tuple[tuple[mi.Float, ...], ...]
    pieces: tuple[tuple[tuple[int, bool], ...], ...]

    def at(self, position: mi.Point3f) -> mi.UInt32:
        """Which of several faces a position on the side lies in."""
        beyond = [dr.dot(mi.Vector3f(*line[:3]), position) > line[3] for line in self.lines]
        found = mi.UInt32(self.faces[-1])
        for face, piece in zip(self.faces, self.pieces, strict=False):
            inside = mi.Bool(True)
            for line, above in piece:
                inside &= beyond[line] if above else ~beyond[line]
            found = dr.select(inside, face, found)
        return found


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A convex body whose faces are among a scene's. Open sides, as a block's on the floor, have no face.

    shut : whether open sides lie on the scene's convex hull, so that nothing enters by them from within it.
    """

    sides: tuple[Side, ...]
    shut: bool

    @property
    def faces(self) -> list[int]:
        """The faces of all sides, in order."""
        return sorted(face for side in self.sides for face in side.faces)

    def met(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32]:
        """Distance to the nearest face, and which; ``none`` where the ray meets none or starts beyond all."""
        enter, at_enter, leave, at_leave = self._span(ray, none)
        outside = (enter > 0) & (at_enter != none)
        t, face = dr.select(outside, enter, leave), dr.select(outside, at_enter, at_leave)
        return t, self._divided(dr.select((enter <= leave) & (t > 0), face, none), ray(t))

    def entered(self, ray: mi.Ray3f, none: int) -> mi.UInt32:
        """The face by which a ray enters; ``none`` where it does not, or by an open side."""
        enter, at_enter, leave, _ = self._span(ray, none)
        return self._divided(dr.select((enter <= leave) & (enter > 0), at_enter, none), ray(enter))

    def left(self, ray: mi.Ray3f, none: int) -> mi.UInt32:
        """The face by which a ray leaves; ``none`` where it does not, or by an open side."""
        enter, _, leave, at_leave = self._span(ray, none)
        return self._divided(dr.select((enter <= leave) & (leave > 0), at_leave, none), ray(leave))

    def _divided(self, face: mi.UInt32, position: mi.Point3f) -> mi.UInt32:
        """Which face, if ``face`` is the first of a side with several."""
        for side in self.sides:
            if len(side.faces) > 1:
                face = dr.select(face == side.faces[0], side.at(position), face)
        return face

    def _span(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32, mi.Float, mi.UInt32]:
        """Distances at which a ray enters the last plane and leaves the first one, each with the side's first face."""
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        at_enter, at_leave = mi.UInt32(none), mi.UInt32(none)
        for side in self.sides:
            t, inwards = _plane(side.row, ray)
            later, sooner = inwards & (t > enter), ~inwards & (t < leave)
            index = mi.UInt32(side.faces[0] if side.faces else none)
            enter, at_enter = dr.select(later, t, enter), dr.select(later, index, at_enter)
            leave, at_leave = dr.select(sooner, t, leave), dr.select(sooner, index, at_leave)
        return enter, at_enter, leave, at_leave

    def blocks(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray meets it before the ray's end, if the ray passes no open side."""
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        for side in self.sides:
            t, inwards = _plane(side.row, ray)
            enter = dr.select(inwards, dr.maximum(enter, t), enter)
            leave = dr.select(inwards, leave, dr.minimum(leave, t))
        nearest = dr.select(enter > 0, enter, leave)
        return (enter <= leave) & (nearest > 0) & (nearest < ray.maxt)


def _plane(row: tuple[mi.Float, ...], ray: mi.Ray3f) -> tuple[mi.Float, mi.Bool]:
    """Distance to a plane along a ray, and whether the ray goes inwards there.

    Along a plane the distance is infinite. Its sign and that of the zero, which counts as a direction, then say
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
    """The convex bodies that faces with ``outlines`` (k, 3) and normals (f, 3), outwards, bound.

    corners : (n, 3) of the whole scene. overlap_mm : how far their planes are moved outwards, so that a ray at an edge
    passes no gap.
    """
    found = []
    for members in _connected(outlines):
        planes = _planes(np.concatenate([outlines[i] for i in members]))
        filled = [_filling(plane, area, outlines, members) for plane, area in planes]
        outwards = all(normals[i] @ plane[:3] > 0 for (plane, _), own in zip(planes, filled, strict=True) for i in own)
        if sorted(i for own in filled for i in own) == members and outwards:
            open_sides = [plane for (plane, _), own in zip(planes, filled, strict=True) if not own]
            shut = all((corners @ plane[:3] - plane[3]).max() < _SAME_MM for plane in open_sides)
            found.append(_body(planes, filled, outlines, overlap_mm, shut))
    return tuple(found)


def convex_room(
    outlines: Sequence[NDArray[np.float64]],
    loose: Sequence[int],
    corners: NDArray[np.float64],
    overlap_mm: float,
) -> ConvexBody | None:
    """The convex hull of the scene's ``corners`` (n, 3), with those ``loose`` faces that fill sides of it; None where
    it has too few to pay: no more than half as many as the hull has sides.
    """
    planes = _planes(corners, most=2 * len(loose))
    filled = [_filling(plane, area, outlines, loose) for plane, area in planes]
    if 2 * sum(map(len, filled)) <= len(planes):
        return None
    return _body(planes, filled, outlines, overlap_mm, shut=False)


def _filling(
    plane: NDArray[np.float64], area: float, outlines: Sequence[NDArray[np.float64]], members: Sequence[int]
) -> tuple[int, ...]:
    """Those of some faces that fill one side of a hull between them; none where they do not."""
    own = [i for i in members if np.abs(outlines[i] @ plane[:3] - plane[3]).max() < _SAME_MM]
    whole = abs(sum(_area(outlines[i]) for i in own) / area - 1) < 1e-6
    return tuple(own) if whole else ()


def _body(
    planes: Sequence[tuple[NDArray[np.float64], float]],
    filled: Sequence[tuple[int, ...]],
    outlines: Sequence[NDArray[np.float64]],
    overlap_mm: float,
    shut: bool,
) -> ConvexBody:
    sides = []
    for (plane, _), own in zip(planes, filled, strict=True):
        lines, pieces = _division(plane, [outlines[i] for i in own])
        sides.append(Side(_one_lane([*plane[:3], plane[3] + overlap_mm]), own, lines, pieces))
    return ConvexBody(tuple(sides), shut)


def _division(
    plane: NDArray[np.float64], outlines: Sequence[NDArray[np.float64]]
) -> tuple[tuple[tuple[mi.Float, ...], ...], tuple[tuple[tuple[int, bool], ...], ...]]:
    """``lines`` and ``pieces`` of a side with these faces."""
    corners = np.concatenate(outlines) if outlines else np.empty((0, 3))
    lines: list[NDArray[np.float64]] = []
    pieces = []
    for outline in outlines[:-1]:
        middle, piece = outline.mean(axis=0), []
        for first, second in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            across = np.cross(plane[:3], second - first)
            line = np.array([*across, across @ first]) / np.linalg.norm(across)
            heights = corners @ line[:3] - line[3]
            if min(heights.max(), -heights.min()) < _SAME_MM:  # at the side's own edge
                continue
            ends = np.array([first, second])
            known = [np.abs(ends @ other[:3] - other[3]).max() < _SAME_MM for other in lines]
            if not any(known):
                known.append(True)
                lines.append(line)
            number = known.index(True)
            piece.append((number, bool(middle @ lines[number][:3] > lines[number][3])))
        pieces.append(tuple(piece))
    return tuple(_one_lane(line) for line in lines), tuple(pieces)


def _one_lane(row: Sequence[float] | NDArray[np.float64]) -> tuple[mi.Float, ...]:
    return tuple(dr.opaque(mi.Float, float(value)) for value in row)


def _connected(outlines: Sequence[NDArray[np.float64]]) -> list[list[int]]:
    """Groups of faces that share corners."""
    groups: list[list[int]] = []
    for index, outline in enumerate(outlines):
        touching = [
            g for g in groups if any(np.linalg.norm(outlines[i][:, None] - outline, axis=2).min() < _SAME_MM for i in g)
        ]
        groups = [g for g in groups if g not in touching]
        groups.append(sorted([*(i for g in touching for i in g), index]))
    return groups


def _planes(corners: NDArray[np.float64], most: float = np.inf) -> list[tuple[NDArray[np.float64], float]]:
    """Planes (n, n . p), n outwards, of the hull of points (k, 3), and the area in each; none of a flat one, or of one
    with more than ``most``, as of a fine mesh."""
    try:
        hull = ConvexHull(corners)
    except QhullError:
        return []
    found: list[tuple[NDArray[np.float64], float]] = []
    for equation, simplex in zip(hull.equations, hull.simplices, strict=True):
        plane, area = np.array([*equation[:3], -equation[3]]), _area(hull.points[simplex])
        for index, (known, sum_) in enumerate(found):
            if np.abs(hull.points[simplex] @ known[:3] - known[3]).max() < _SAME_MM and known[:3] @ plane[:3] > 0:
                found[index] = known, sum_ + area
                break
        else:
            found.append((plane, area))
        if len(found) > most:
            return []
    return found


def _area(outline: NDArray[np.float64]) -> float:
    return 0.5 * float(np.linalg.norm(np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0)))
