"""A control variate for gathering rays: even light on each flat face, whose mean over a hemisphere is a form factor.

A ray crosses one wall of a convex room, and enters each convex block by one face, whatever lies before it. Gathering
rays take off the light of these faces, and their form factors, which are known exactly, put it back. What is left is
noise from the differences only: no longer from how many rays happen to meet a bright face. A pixel takes off the share
that leaves the least noise, one of the walls' light and one of the blocks'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import FlatFaces, Tracer
from .lamp import form_factor
from .patches import Patches

__all__ = ["CONTROLLED", "FaceControls", "build_face_controls"]

#: So many accumulators of the patches' light are controlled, beside direct light. The first hold nearly all of it.
CONTROLLED = 3

#: Faces whose centres lie within this of another one's plane, and in its outline, overlap it, mm.
_SAME_MM = 1e-3


if TYPE_CHECKING:
    #: Of the walls, and of all blocks: direct light by material, then the light of the accumulators.
    Controls = tuple[list[mi.Float], list[mi.Float]]


@dataclass(frozen=True, eq=False)
class FaceControls:
    """walls : faces of the convex room, by their index. faces : those that have light, first the walls, then those of
    blocks.

    corners : four of each face, a triangle's last one twice. light : of each face, by index, its direct light and that
    of CONTROLLED accumulators; of a block's face what it has more than the room's mean. Of no face, 0. material : of
    each face.
    """

    geometry: FlatFaces
    walls: tuple[int, ...]
    faces: mi.UInt32
    count: int
    corners: mi.Float
    light: mi.Float
    material: mi.UInt32

    def along(self, ray: mi.Ray3f, materials: int, active: mi.Bool) -> Controls:
        """The faces' light along each ray."""
        sums = []
        for face in self.geometry.crossed(ray, self.walls):
            light = dr.gather(mi.Vector4f, self.light, face, active)
            material = dr.gather(mi.UInt32, self.material, face, active)
            sums.append(_by_material(light, material, materials))
        none = [mi.Float(0)] * (materials + CONTROLLED)
        return sums[0], [sum(parts, zero) for zero, *parts in zip(none, *sums[1:], strict=True)]

    def mean(self, position: mi.Point3f, normal: mi.Vector3f, materials: int) -> Controls:
        """The mean of ``along`` over the hemisphere, weighted by the cosine."""

        def body(i: mi.UInt32, walls: list[mi.Float], blocks: list[mi.Float]) -> tuple[mi.UInt32, *Controls]:
            face = dr.gather(mi.UInt32, self.faces, i)
            corners = [dr.gather(mi.Point3f, self.corners, 4 * face + k) for k in range(4)]
            edges = list(zip(corners, [*corners[1:], corners[0]], strict=True))
            outwards = dr.cross(corners[1] - corners[0], corners[2] - corners[0])
            front = dr.dot(position - corners[0], outwards) > 0
            share = dr.select(front, form_factor(edges, position, normal), 0)
            light = dr.gather(mi.Vector4f, self.light, face)
            material = dr.gather(mi.UInt32, self.material, face)
            more = [share * part for part in _by_material(light, material, materials)]
            of_wall = i < wall_count
            return (
                i + 1,
                [old + dr.select(of_wall, new, 0) for old, new in zip(walls, more, strict=True)],
                [old + dr.select(of_wall, 0, new) for old, new in zip(blocks, more, strict=True)],
            )

        lanes = dr.width(position)
        wall_count, total = dr.opaque(mi.UInt32, len(self.walls)), dr.opaque(mi.UInt32, self.count)
        walls, blocks = ([dr.zeros(mi.Float, lanes) for _ in range(materials + CONTROLLED)] for _ in range(2))
        start = dr.zeros(mi.UInt32, lanes), walls, blocks
        _, walls, blocks = dr.while_loop(start, lambda i, *_: i < total, body)
        return walls, blocks


def _by_material(light: mi.Vector4f, material: mi.UInt32, materials: int) -> list[mi.Float]:
    return [*(dr.select(material == m, light[0], 0) for m in range(materials)), *list(light)[1:]]


def build_face_controls(
    tracer: Tracer, patches: Patches, direct: NDArray, finer: Patches, indirect: NDArray
) -> FaceControls | None:
    """direct : (p,) of the patches. indirect : (n, k) of the finer ones. None for scenes without flat walls."""
    geometry = tracer.accelerator
    if not isinstance(geometry, FlatFaces):
        return None
    none = len(geometry.planes)
    triangles = geometry.triangles.numpy().reshape(-1, 2)
    painted = tracer.material[triangles[:, 0]] < len(tracer.material_names)
    walls: list[int] = []
    for face in range(none):
        normal, height = geometry.planes[face, 0, :3], geometry.planes[face, 0, 3]
        inwards = (tracer.vertices @ normal).max() > height + _SAME_MM
        if geometry.hull[face] and painted[face] and inwards and not _overlaps(geometry, face, walls):
            walls.append(face)
    of_blocks = [face for body in geometry.bodies for face in body.faces if painted[face]]
    light, area = np.zeros((none + 1, 1 + CONTROLLED)), np.zeros(none + 1)
    for face in (*walls, *of_blocks):
        own, own_finer = (np.isin(_triangle(p), triangles[face]) for p in (patches, finer))
        if not (own.any() and own_finer.any()):  # in a group of another face's patches
            continue
        light[face, 0] = np.average(direct[own], weights=patches.area[own])
        values = np.average(indirect[own_finer, :CONTROLLED], axis=0, weights=finer.area[own_finer])
        light[face, 1 : 1 + len(values)] = values
        area[face] = patches.area[own].sum()
    if not area[walls].any():
        return None
    known = [face for face in of_blocks if area[face]]
    light[known] -= np.average(light[walls], axis=0, weights=area[walls])
    corners = np.array([outline[[0, 1, 2, -1]] for outline in geometry.outlines])
    faces = np.array([*walls, *known])
    return FaceControls(
        geometry,
        tuple(walls),
        device_array(mi.UInt32, faces),
        len(faces),
        device_array(mi.Float, corners),
        device_array(mi.Float, light),
        device_array(mi.UInt32, [*tracer.material[triangles[:, 0]], 0]),
    )


def _triangle(patches: Patches) -> NDArray[np.int64]:
    """(p,) a triangle of each patch."""
    return patches.triangle[np.searchsorted(patches.patch, np.arange(len(patches)))]


def _overlaps(geometry: FlatFaces, face: int, others: list[int]) -> bool:
    """Whether the centre of a face lies in one of the others, or theirs in it."""

    def within(point: NDArray, planes: NDArray) -> bool:
        plane, *sides = planes @ [*point, -1.0]
        return abs(plane) < _SAME_MM and min(sides) > 0

    centre = [outline.mean(axis=0) for outline in geometry.outlines]
    return any(
        within(centre[face], geometry.planes[other]) or within(centre[other], geometry.planes[face]) for other in others
    )
