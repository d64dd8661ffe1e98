"""Lamp offset: the lamp and the hole around it sit elsewhere in the ceiling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene, Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Vertices closer to a corner of the lamp than this are the hole's own, mm.
TOUCHING_MM = 1e-6


def _area_vectors(surface: Surface, vertices_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c = (vertices_mm[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def _with_moved_hole(surface: Surface, corners: NDArray[np.float64], shift: NDArray[np.float64]) -> Surface:
    """The hole's edges keep their directions, so the triangles around it stay valid while it stays inside."""
    distance = np.linalg.norm(surface.vertices_mm[:, None] - corners, axis=-1)
    hole = distance.min(axis=1) < TOUCHING_MM
    if not hole.any():
        return surface
    vertices = surface.vertices_mm + hole[:, None] * shift
    before, after = (_area_vectors(surface, v) for v in (surface.vertices_mm, vertices))
    if np.einsum("fi,fi->f", before, after).min() <= 0:
        found = f"an offset of {shift[0]:g}, {shift[2]:g} mm, which carries the lamp out of '{surface.name}'"
        raise InputError("effect lamp-offset", found, "an offset that leaves the lamp inside")
    return replace(surface, vertices_mm=vertices)


def _apply(scene: Scene, dx_mm: float, dz_mm: float) -> Scene:
    """Raises InputError where a lamp would leave the ceiling, or where its plane is upright."""
    lamps = []
    for one in scene.lamps:
        scene, moved = _moved(scene, one, dx_mm, dz_mm)
        lamps.append(moved)
    return replace(scene, lamp=lamps[0], further_lamps=tuple(lamps[1:]))


def _moved(scene: Scene, one: Lamp, dx_mm: float, dz_mm: float) -> tuple[Scene, Lamp]:
    """The scene with the hole of a lamp moved, and the lamp."""
    lamp = one.surface
    normal = _area_vectors(lamp, lamp.vertices_mm).sum(axis=0)
    if abs(normal[1]) < 1e-3 * np.linalg.norm(normal):
        expected = "a lamp that a shift in x and z keeps in its plane"
        raise InputError("effect lamp-offset", "a lamp in an upright plane", expected)
    shift = np.array([dx_mm, -(normal[0] * dx_mm + normal[2] * dz_mm) / normal[1], dz_mm])
    surfaces = tuple(_with_moved_hole(surface, lamp.vertices_mm, shift) for surface in scene.surfaces)
    moved = replace(one, surface=replace(lamp, vertices_mm=lamp.vertices_mm + shift))
    return replace(scene, surfaces=surfaces), moved


EFFECT = Effect(
    id="lamp-offset",
    stage="scene",
    title="the lamp sits elsewhere in the ceiling",
    summary="The lamp sits elsewhere in the ceiling's plane, its hole with it: shifted by dx along x and dz along z.",
    parameters=(
        Parameter("dx_mm", "mm", null=0.0, low=-150.0, high=150.0, step=2.0),
        Parameter("dz_mm", "mm", null=0.0, low=-150.0, high=150.0, step=2.0),
    ),
    apply=_apply,
    confirm="Survey the lamp's corners, or look for its edges in the picture: all shadows shift the other way.",
)
