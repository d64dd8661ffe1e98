"""Lamp reflectance: the lamp's own surface reflects more or less than the model says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _level(scene: Scene) -> float:
    """The lamps' mean reflectance over 400 to 700 nm and over their area."""
    weights = INTEGRAL_GRID.weights
    each = [float(weights @ lamp.reflectance.at(WAVELENGTH_NM) / weights.sum()) for lamp in scene.lamps]
    return float(scene.lamp_areas @ each)


def _apply(scene: Scene, reflectance: float) -> Scene:
    """The tables times a factor, at most 1, that makes ``reflectance`` their mean; black lamps become grey."""
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
    summary="The lamp's own surface reflects more or less than the model says: its mean reflectance over 400 to "
    "700 nm is the given one, the shape of its spectrum kept. It does nothing at the model's own value.",
    parameters=(Parameter("reflectance", "1", null=0.78, null_in=_level, low=0.0, high=1.0, step=0.05),),
    apply=_apply,
    confirm="Measure the lamp's surface, switched off, with a spectrophotometer. In the picture all surfaces "
    "brighten by less than a percent, more where the paint is bright: bands differ more than places.",
    sources=("the published Cornell Box: a lamp of reflectance 0.78",),
)
