"""Lamp reflectance: the lamp's surface reflects more or less than in the model.

The lamps' reflectance tables are scaled by one factor, so that their mean over 400 to 700 nm and over the lamps' area
is the given one; values stay at most 1. The cause is a diffuser whose reflectance nobody measured.

Parameters: reflectance, without unit, null value that of the scene, 0.78 in the published box.
Source: the published Cornell Box, a lamp of reflectance 0.78.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _level(scene: Scene) -> float:
    """Mean reflectance of the lamps over 400 to 700 nm and over their area."""
    weights = INTEGRAL_GRID.weights
    each = [float(weights @ lamp.reflectance.at(WAVELENGTH_NM) / weights.sum()) for lamp in scene.lamps]
    return float(scene.lamp_areas @ each)


def _apply(scene: Scene, reflectance: float) -> Scene:
    """Scene with the lamps' tables scaled so that ``reflectance`` is their mean.

    Values are clipped at 1. The table of a black lamp becomes constant, as does every table if all lamps are black.
    """
    before = _level(scene)
    if reflectance == before:
        return scene

    def changed(lamp: Lamp) -> Lamp:
        table = lamp.reflectance
        values = table.values * (reflectance / before) if before > 0 else np.full_like(table.values, reflectance)
        return replace(lamp, reflectance=Spectrum(table.wavelength_nm, np.minimum(values, 1.0), table.outside))

    return scene.with_lamps(changed)


EFFECT = Effect(
    id="lamp-reflectance",
    stage="scene",
    title="the lamp's surface reflects more or less",
    in_words="the lamp's surface reflects {reflectance:.1%} of the light on it",
    summary="The lamp's surface reflects more or less than in the model. Its mean reflectance over 400 to "
    "700 nm is the given one; the shape of its spectrum is kept. The effect does nothing at the model's value.",
    parameters=(Parameter("reflectance", "1", null=0.78, null_in=_level, low=0.0, high=1.0, step=0.05),),
    apply=_apply,
    confirm="Switch the lamp off and measure its surface with a spectrophotometer. In the photograph all surfaces "
    "brighten by less than a percent, more where the paint is bright. Bands differ more than places.",
    sources=("the published Cornell Box: a lamp of reflectance 0.78",),
)
