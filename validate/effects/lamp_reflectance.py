"""Lamp reflectance: the lamp's own surface reflects more or less than the model says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM

from ._effect import Effect, Parameter

__all__ = ["EFFECT"]


def _level(scene: Scene) -> float:
    """The lamp's mean reflectance over 400 to 700 nm."""
    weights = INTEGRAL_GRID.weights
    return float(weights @ scene.lamp.reflectance.at(WAVELENGTH_NM) / weights.sum())


def _apply(scene: Scene, reflectance: float) -> Scene:
    """The table times a factor, at most 1, that makes ``reflectance`` its mean; a black lamp becomes grey."""
    table, before = scene.lamp.reflectance, _level(scene)
    if reflectance == before:
        return scene
    values = table.values * (reflectance / before) if before > 0 else np.full_like(table.values, reflectance)
    changed = Spectrum(table.wavelength_nm, np.minimum(values, 1.0), table.outside)
    return replace(scene, lamp=replace(scene.lamp, reflectance=changed))


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
