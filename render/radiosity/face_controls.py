"""A control variate for gathering rays: even light on each flat face.

A ray crosses one wall of a convex room, and enters each convex block by one face, whatever lies in front. Let g(d) be
the even light of the faces that a ray of direction d crosses. Its mean G over the cosine-weighted hemisphere is known
exactly: the sum of the faces' light times their form factors. With the light L(d) that a gathering ray returns, the
estimate

    mean of (L(d) - a g(d)) + a G

has the same mean as that of L(d) for every share a, so it is unbiased. It is less noisy if L and a g vary together: no
noise is left from the number of rays that happen to hit a bright face, only that of the differences within faces. Walls
and blocks have separate shares. Each pixel uses the shares of least variance, from pilot rays with random numbers that
the image does not use.
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

#: Number of accumulators of the patches' light that are controlled, next to direct light: the first ones hold nearly
#: all of it.
CONTROLLED = 3

#: Largest distance of the centre of a face from the plane of another one that it overlaps, mm.
_SAME_MM = 1e-3


if TYPE_CHECKING:
    #: Of the walls, and of all blocks: direct light by material, then the light of the accumulators.
    Controls = tuple[list[mi.Float], list[mi.Float]]


@dataclass(frozen=True, eq=False)
class FaceControls:
    """Even light of the faces of a scene."""

    #: The flat faces.
    geometry: FlatFaces
    #: Indices of the walls of the convex room.
    walls: tuple[int, ...]
    #: Indices of the faces that have light: first the walls, then those of blocks.
    faces: mi.UInt32
    #: Number of these faces.
    count: int
    #: (f, 4, 3) corners of each face, mm; the last one of a triangle twice.
    corners: mi.Float
    #: (f + 1, 1 + CONTROLLED) direct light of each face, and that of the first accumulators; of a block's face the
    #: excess over the room's mean. The last row, 0, stands for no face.
    light: mi.Float
    #: (f + 1,) index of the material of each face.
    material: mi.UInt32

    def along(self, ray: mi.Ray3f, materials: int, active: mi.Bool) -> Controls:
        """Light of the faces that rays cross.

        Parameters
        ----------
        ray
            One ray per lane, from within the room.
        materials
            Number of materials.
        active
            Lanes that are evaluated.

        Returns
        -------
        Controls
            Controls of the walls, and sums over the blocks: direct light by material, then the accumulators.
        """
        sums = []
        for face in self.geometry.crossed(ray, self.walls):
            light = dr.gather(mi.Vector4f, self.light, face, active)
            material = dr.gather(mi.UInt32, self.material, face, active)
            sums.append(_by_material(light, material, materials))
        none = [mi.Float(0)] * (materials + CONTROLLED)
        return sums[0], [sum(parts, zero) for zero, *parts in zip(none, *sums[1:], strict=True)]

    def mean(self, position: mi.Point3f, normal: mi.Vector3f, materials: int) -> Controls:
        """Mean of `along` over the hemisphere, weighted by the cosine.

        Parameters
        ----------
        position
            Point of each lane, mm.
        normal
            Unit normal there.
        materials
            Number of materials.

        Returns
        -------
        Controls
            In the same order, by the form factors of the faces.
        """

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
    """Direct light as one number for each material, then the other numbers."""
    return [*(dr.select(material == m, light[0], 0) for m in range(materials)), *list(light)[1:]]


def build_face_controls(
    tracer: Tracer, patches: Patches, direct: NDArray, finer: Patches, indirect: NDArray
) -> FaceControls | None:
    """Even light of a scene's faces, as means over their patches.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    patches
        Its patches.
    direct
        (p,) direct light of the patches by one lamp.
    finer
        Its finer patches.
    indirect
        (n, k) coefficients of the light of the finer patches.

    Returns
    -------
    FaceControls | None
        The light; None for a scene without flat walls.
    """
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
    candidates = [face for body in geometry.bodies for face in body.faces if painted[face]]
    light, area = np.zeros((none + 1, 1 + CONTROLLED)), np.zeros(none + 1)
    for face in (*walls, *candidates):
        in_face, finer_in_face = (np.isin(_triangle(p), triangles[face]) for p in (patches, finer))
        if not (in_face.any() and finer_in_face.any()):  # in a group of another face's patches
            continue
        light[face, 0] = np.average(direct[in_face], weights=patches.area[in_face])
        values = np.average(indirect[finer_in_face, :CONTROLLED], axis=0, weights=finer.area[finer_in_face])
        light[face, 1 : 1 + len(values)] = values
        area[face] = patches.area[in_face].sum()
    if not area[walls].any():
        return None
    block_faces = [face for face in candidates if area[face]]
    light[block_faces] -= np.average(light[walls], axis=0, weights=area[walls])
    corners = np.array([outline[[0, 1, 2, -1]] for outline in geometry.outlines])
    faces = np.array([*walls, *block_faces])
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
    """Whether the centre of a face lies in another one, or the centre of that in the face."""

    def within(point: NDArray, planes: NDArray) -> bool:
        plane, *sides = planes @ [*point, -1.0]
        return abs(plane) < _SAME_MM and min(sides) > 0

    centre = [outline.mean(axis=0) for outline in geometry.outlines]
    return any(
        within(centre[face], geometry.planes[other]) or within(centre[other], geometry.planes[face]) for other in others
    )
