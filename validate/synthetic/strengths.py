"""Strength of an effect: the chi2 per sample by which it changes a capture, and effects of a given strength."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import after_stage
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect, Parameter
from cboxlab.rendering.model import Model, displacement
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import temporary_folder
from numpy.typing import NDArray

from ..compare import Nuisances, prepare, rendered_from, solved_light
from ..diagnose import judged_by_priors, nuisance_priors
from ..predict import Predictor
from .model_capture import write_model_capture

__all__ = ["STRENGTHS", "Scale", "at_strength", "scale_of"]

#: Expected change of chi2 per sample at 128 x 128 pixels, with the lamp's scale fitted. Effects that imitate a nuisance
#: only show as a deviation of the fitted camera and lamp from their priors: 5, 10 and 17 standard deviations.
STRENGTHS: Mapping[str, float] = {"faint": 0.0024, "weak": 0.06, "medium": 1.0, "strong": 8.0}

#: Squared deviation from the priors of a medium effect; the strength is proportional to its square.
_PULL = 100.0

_CLOSE = 0.02
_MOST_TRIALS = 40

#: Chi2 per sample of an applied effect.
Scale = Callable[[AppliedEffect], float]


def scale_of(model: Model, camera: Camera, settings: CaptureSettings, seed: int) -> Scale:
    """A function that computes an effect's chi2 per sample in the model's capture (a temporary one without it).

    Raises InputError without a compiled variant.
    """
    variant.require_compiled("strength")
    with temporary_folder() as folder:
        place = folder / "capture"
        write_model_capture(place, model, camera, settings, seed, relative_error=5e-3)
        prepared = prepare(load_capture(place), Model(model.scene))
        light = solved_light(prepared, model.render, model.effects)
        coarse = replace(model.render, noise=1.0)
        rendered = rendered_from(prepared, light, prepared.calibrated_camera, coarse, model.effects)
    predictor, used = rendered.predictor, rendered.used
    again = predictor.resampled()
    base = predictor.signal(model.effects)
    sigma = np.sqrt(prepared.calibration.predicted_variance(base)[used])
    level: NDArray[np.float64] = base[used] / sigma
    level /= np.linalg.norm(level)

    priors = nuisance_priors(prepared.calibrated_camera, prepared.lamp_sigma)

    def change(seen_by: Predictor, effect: AppliedEffect) -> NDArray[np.float64]:
        moved = (seen_by.signal((*model.effects, effect)) - seen_by.signal(model.effects))[used] / sigma
        return np.asarray(moved - level * (level @ moved))

    def scale(effect: AppliedEffect) -> float:
        if judged_by_priors(effect, camera):
            lamps = (
                scene.lamp_radiance(WAVELENGTH_NM).sum()
                for scene in (after_stage(prepared.scene, (effect,), "scene"), prepared.scene)
            )
            brighter = float(np.divide(*lamps)) - 1
            pull = priors @ Nuisances(displacement(camera, (), (effect,)), brighter).vector
            return (float(pull @ pull) / _PULL) ** 2
        # product of two estimates with independent random numbers: the square of one would be biased by its noise
        first, second = (change(each, effect) for each in (predictor, again))
        return float(first @ second) / len(sigma)

    return scale


def at_strength(effect: AppliedEffect, wanted: float, scale: Scale) -> AppliedEffect | None:
    """The effect with the distances of its numbers from null scaled by a common factor to the strength ``wanted``.

    None if the bounds do not allow this strength.
    """
    free = [p for p in effect.effect.numbers if p.null is not None]
    if not free:
        return effect
    low, high, factor = 0.0, np.inf, 1.0
    for _ in range(_MOST_TRIALS):
        trial = AppliedEffect(effect.effect, {**effect.values, **_scaled(free, effect.values, factor)})
        try:
            reached = scale(trial)
        except InputError:
            reached = np.inf  # not possible (e.g. a lamp outside the ceiling): reduce
        if abs(reached / wanted - 1) < _CLOSE:
            return trial
        if reached < wanted:
            if all(trial.values[p.name] in (p.low, p.high) for p in free):
                return None
            low = factor
        else:
            high = factor
        if np.isinf(high):
            factor *= 2.0
        else:
            factor = np.sqrt(max(low, 1e-4 * high) * high)
            if high / max(low, 1e-9) < 1 + 1e-3:
                return None
    return None


def _scaled(free: list[Parameter], values: Mapping[str, str | float], factor: float) -> dict[str, float]:
    """Numbers with ``factor`` times the distance from null, in the coordinates of their scales, clipped to bounds."""
    result = {}
    for p in free:
        distance = p.to_coordinate(float(values[p.name])) - p.null_coordinate
        result[p.name] = p.from_coordinate(float(np.clip(p.null_coordinate + factor * distance, *p.coordinate_bounds)))
    return result
