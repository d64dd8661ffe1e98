"""Wall reflectance: one material reflects more or less than its table.

rho' = min(scale rho, 1) at every wavelength; a texture is scaled pixel by pixel. The cause is another batch of paint, a
second coat, or the geometry of the spectrophotometer.

Parameters: material, name of the paint; scale, without unit, null value 1.
Source: no formula from a publication.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum

from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]


def _apply(scene: Scene, material: str, scale: float) -> Scene:
    """Scene with the material's reflectance scaled; InputError for an unknown material."""
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
    in_words="{material} reflects {scale:.2%} of what its table says",
    summary="One paint reflects more or less than its table: the table times scale, at most 1.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("scale", "1", null=1.0, low=0.5, high=1.5, step=1e-2),
    ),
    apply=_apply,
    confirm="Measure a fresh sample of the paint and the wall itself with a spectrophotometer of the "
    "table's geometry. In the photograph all surfaces of the paint change, and the surfaces that they light.",
)
