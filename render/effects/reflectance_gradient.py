"""Reflectance gradient: one surface is darker at one end.

rho' = rho (1 - a s), s from 0 to 1 along a positive axis over the surface's extent. The cause is dirt or uneven paint.

Parameters: surface, its name; axis, x, y or z; amplitude a, without unit, null value 0.
Source: linear model of uneven paint or dirt; no publication.
"""

from __future__ import annotations

import numpy as np

from ..perturbation import PatchLight
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Surfaces of the published box; other scenes name their surfaces otherwise.
_SURFACES = ("floor", "ceiling", "back", "left", "right", "short-block", "tall-block")


def _apply(light: PatchLight, surface: str, axis: str, amplitude: float) -> PatchLight:
    transport = light.transport
    scene, patches = light.scene, transport.light.patches
    index = index_of(surface, (s.name for s in scene.surfaces), "reflectance-gradient: surface")
    along = "xyz".index(axis)
    extent = scene.surfaces[index].vertices_mm[:, along]
    length = max(float(np.ptp(extent)), 1e-9)

    def factor(position: np.ndarray, on_surface: np.ndarray) -> np.ndarray:
        s = np.clip((position[:, along] - extent.min()) / length, 0, 1)
        return np.where(on_surface, 1 - amplitude * s, 1.0)[:, None]

    return light.change(
        patch_reflectance=light.patch_reflectance * factor(patches.centre, patches.surface == index),
        fragment_reflectance=light.fragment_reflectance * factor(transport.position, transport.surface == index),
    )


EFFECT = Effect(
    id="reflectance-gradient",
    stage="transport",
    title="a surface is darker at one end",
    summary="One surface reflects less at one end: the table's reflectance times 1 - amplitude s, s from 0 to 1 along "
    "the positive axis over the surface's extent.",
    parameters=(
        Parameter("surface", choices=_SURFACES, kind="surface"),
        Parameter("axis", choices=("x", "y", "z")),
        Parameter("amplitude", "1", null=0.0, low=-0.3, high=0.9, step=0.02),
    ),
    apply=_apply,
    confirm="Measure the paint's reflectance with a spectrophotometer at both ends of the surface.",
    sources=("linear model of uneven paint or dirt",),
)
