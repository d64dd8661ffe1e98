"""Lamp offset: the lamp and the hole around it are elsewhere in the ceiling.

All corners of the lamp, and the vertices of the hole around it, are shifted by dx along x and dz along z, within the
plane of the lamp. The cause is a wrong survey or a lamp that was mounted again.

Parameters: dx_mm and dz_mm, mm, null value 0.
Source: translation; no publication.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene, Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Distance from a corner of the lamp, mm, within which a vertex belongs to its hole: rounding, not geometry.
TOUCHING_MM = 1e-6

#: Offset that is no finding, mm: a lamp is set into its hole by hand. Two captures of another simulator, whose lamp has
#: a frame 0.1 mm deep, leave 0.40 and 0.44 mm; four tolerances are 0.6 mm.
_MOUNT_TOLERANCE_MM = 0.15


def _area_vectors(surface: Surface, vertices_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 3) normals of the triangles, of length twice their areas, for other vertices."""
    a, b, c = (vertices_mm[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def _with_moved_hole(surface: Surface, corners: NDArray[np.float64], shift: NDArray[np.float64]) -> Surface:
    """Surface with the vertices of the lamp's hole shifted; the same surface if it has no hole.

    The hole's edges keep their directions, so the triangles around it stay valid while it stays inside.
    """
    distance = np.linalg.norm(surface.vertices_mm[:, None] - corners, axis=-1)
    hole = distance.min(axis=1) < TOUCHING_MM
    if not hole.any():
        return surface
    vertices = surface.vertices_mm + hole[:, None] * shift
    before, after = (_area_vectors(surface, v) for v in (surface.vertices_mm, vertices))
    if np.einsum("fi,fi->f", before, after).min() <= 0:
        offset = f"an offset of {shift[0]:g}, {shift[2]:g} mm, which carries the lamp out of '{surface.name}'"
        raise InputError("effect lamp-offset", offset, "an offset that leaves the lamp inside")
    return replace(surface, vertices_mm=vertices)


def _apply(scene: Scene, dx_mm: float, dz_mm: float) -> Scene:
    """Scene with all lamps moved; InputError for a lamp that leaves its ceiling or is upright."""
    lamps = []
    for lamp in scene.lamps:
        scene, moved = _moved(scene, lamp, dx_mm, dz_mm)
        lamps.append(moved)
    return replace(scene, lamp=lamps[0], further_lamps=tuple(lamps[1:]))


def _moved(scene: Scene, lamp: Lamp, dx_mm: float, dz_mm: float) -> tuple[Scene, Lamp]:
    """Scene with the hole of a lamp moved, and the moved lamp."""
    surface = lamp.surface
    normal = _area_vectors(surface, surface.vertices_mm).sum(axis=0)
    if abs(normal[1]) < 1e-3 * np.linalg.norm(normal):
        expected = "a lamp that a shift in x and z keeps in its plane"
        raise InputError("effect lamp-offset", "a lamp in an upright plane", expected)
    shift = np.array([dx_mm, -(normal[0] * dx_mm + normal[2] * dz_mm) / normal[1], dz_mm])
    surfaces = tuple(_with_moved_hole(other, surface.vertices_mm, shift) for other in scene.surfaces)
    moved = replace(lamp, surface=replace(surface, vertices_mm=surface.vertices_mm + shift))
    return replace(scene, surfaces=surfaces), moved


EFFECT = Effect(
    id="lamp-offset",
    stage="scene",
    title="the lamp is elsewhere in the ceiling",
    in_words="the lamp is {dx_mm:+.1f} mm off in x and {dz_mm:+.1f} mm in z",
    summary="The lamp and its hole are elsewhere in the ceiling's plane: shifted by dx along x and by dz along z.",
    parameters=(
        Parameter("dx_mm", "mm", null=0.0, low=-150.0, high=150.0, step=2.0, tolerance=_MOUNT_TOLERANCE_MM),
        Parameter("dz_mm", "mm", null=0.0, low=-150.0, high=150.0, step=2.0, tolerance=_MOUNT_TOLERANCE_MM),
    ),
    apply=_apply,
    confirm="Survey the lamp's corners, or compare its edges in the photograph. All shadows shift the other way.",
)
