"""Wall reflectance: one material reflects more or less than its table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum

from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]


def _apply(scene: Scene, material: str, scale: float) -> Scene:
    """Reflectances stay below or at 1. Raises InputError for an unknown material."""
    index_of(material, scene.materials, "wall-reflectance: material")
    before = scene.materials[material]
    table = before.reflectance
    scaled = Spectrum(table.wavelength_nm, np.minimum(table.values * scale, 1.0), table.outside)
    texture = None if before.texture is None else before.texture.scaled(scale)
    changed = replace(before, reflectance=scaled, texture=texture)
    return replace(scene, materials={**scene.materials, material: changed})


EFFECT = Effect(
    id="wall-reflectance",
    stage="scene",
    title="a paint reflects more or less than its table",
    summary="One paint reflects more or less than its table: the table times scale, at most 1.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("scale", "1", null=1.0, low=0.5, high=1.5, step=1e-2),
    ),
    apply=_apply,
    confirm="Measure a fresh sample of the paint beside the wall's own, with a spectrophotometer of the "
    "table's geometry. In the picture all surfaces of the paint change, and what they light changes with "
    "them.",
)
