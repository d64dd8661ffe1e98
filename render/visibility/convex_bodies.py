"""Blocks among flat faces: rays meet a convex body where they enter the last of its planes, or leave the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..device import dr, mi

__all__ = ["ConvexBody", "convex_bodies"]

#: Corners are one point, and lie in one plane, within this, mm.
_SAME_MM = 1e-4


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A convex body whose faces are among a scene's. Open sides, as a block's on the floor, have planes without a face.

    rows : (n, n . p) of each plane, n outwards, in numbers of one lane. faces : of each plane, the index of its face;
    None for an open side. shut : whether open sides lie on the scene's convex hull, so that nothing enters by them from
    within it.
    """

    rows: tuple[tuple[mi.Float, ...], ...]
    faces: tuple[int | None, ...]
    shut: bool

    def met(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32]:
        """Distance to the nearest face, and which; ``none`` where the ray meets none or starts beyond all."""
        enter, at_enter, leave, at_leave = self._span(ray, none)
        outside = (enter > 0) & (at_enter != none)
        t, face = dr.select(outside, enter, leave), dr.select(outside, at_enter, at_leave)
        return t, dr.select((enter <= leave) & (t > 0), face, none)

    def entered(self, ray: mi.Ray3f, none: int) -> mi.UInt32:
        """The face by which a ray enters; ``none`` where it does not, or by an open side."""
        enter, at_enter, leave, _ = self._span(ray, none)
        return dr.select((enter <= leave) & (enter > 0), at_enter, none)

    def _span(self, ray: mi.Ray3f, none: int) -> tuple[mi.Float, mi.UInt32, mi.Float, mi.UInt32]:
        """Distances at which a ray enters the last plane and leaves the first one, each with the plane's face."""
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        at_enter, at_leave = mi.UInt32(none), mi.UInt32(none)
        for row, face in zip(self.rows, self.faces, strict=True):
            t, inwards = _plane(row, ray)
            later, sooner = inwards & (t > enter), ~inwards & (t < leave)
            index = mi.UInt32(none if face is None else face)
            enter, at_enter = dr.select(later, t, enter), dr.select(later, index, at_enter)
            leave, at_leave = dr.select(sooner, t, leave), dr.select(sooner, index, at_leave)
        return enter, at_enter, leave, at_leave

    def blocks(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray meets it before the ray's end, if the ray passes no open side."""
        enter, leave = mi.Float(-dr.inf), mi.Float(dr.inf)
        for row in self.rows:
            t, inwards = _plane(row, ray)
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
    outlines: Sequence[NDArray[np.float64]], normals: NDArray[np.float64], overlap_mm: float
) -> tuple[ConvexBody, ...]:
    """The convex bodies that faces with corners (k, 3) and normals (f, 3), outwards, bound.

    overlap_mm : how far their planes are moved outwards, so that a ray at an edge passes no gap.
    """
    found = []
    everything = np.concatenate(outlines)
    for members in _connected(outlines):
        corners = np.concatenate([outlines[i] for i in members])
        try:
            hull = ConvexHull(corners)
        except QhullError:  # flat
            continue
        sides = _sides(hull)
        faces: list[int | None] = []
        for plane, area in sides:
            own = [
                i for i in members
                if np.abs(outlines[i] @ plane[:3] - plane[3]).max() < _SAME_MM and normals[i] @ plane[:3] > 0
            ]  # fmt: skip
            whole = len(own) == 1 and abs(_area(outlines[own[0]]) / area - 1) < 1e-6
            faces.append(own[0] if whole else None)
        if sorted(face for face in faces if face is not None) == members:
            grown = [[*plane[:3], plane[3] + overlap_mm] for plane, _ in sides]
            rows = tuple(tuple(dr.opaque(mi.Float, float(v)) for v in plane) for plane in grown)
            open_sides = [plane for (plane, _), face in zip(sides, faces, strict=True) if face is None]
            shut = all((everything @ plane[:3] - plane[3]).max() < _SAME_MM for plane in open_sides)
            found.append(ConvexBody(rows, tuple(faces), shut))
    return tuple(found)


def _connected(outlines: Sequence[NDArray[np.float64]]) -> list[list[int]]:
    """Groups of faces that share corners."""
    groups: list[list[int]] = []
    for index, outline in enumerate(outlines):
        touching = [
            g for g in groups
            if any(np.linalg.norm(outlines[i][:, None] - outline, axis=2).min() < _SAME_MM for i in g)
        ]  # fmt: skip
        groups = [g for g in groups if g not in touching]
        groups.append(sorted([*(i for g in touching for i in g), index]))
    return groups


def _sides(hull: ConvexHull) -> list[tuple[NDArray[np.float64], float]]:
    """Planes (n, n . p) of a hull and the area in each."""
    found: list[tuple[NDArray[np.float64], float]] = []
    for equation, simplex in zip(hull.equations, hull.simplices, strict=True):
        plane, area = np.array([*equation[:3], -equation[3]]), _area(hull.points[simplex])
        for index, (known, sum_) in enumerate(found):
            if (
                np.abs(hull.points[simplex] @ known[:3] - known[3]).max() < _SAME_MM
                and known[:3] @ plane[:3] > 0
            ):
                found[index] = known, sum_ + area
                break
        else:
            found.append((plane, area))
    return found


def _area(outline: NDArray[np.float64]) -> float:
    return 0.5 * float(np.linalg.norm(np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0)))
