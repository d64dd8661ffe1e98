"""How strong an effect is: the chi2 per sample by which it changes a capture, and effects made as strong as wanted."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.render.laboratory import CaptureSettings
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray

from .effects import AppliedEffect, Parameter
from .linear_model import nuisance_priors
from .model import Model
from .pipeline import prepare, rendered_from, solved_light
from .predictor import Predictor
from .selection import PRIOR_EFFECTS
from .synthetic import write_model_capture

__all__ = ["STRENGTHS", "Scale", "at_strength", "scale_of"]

#: Expected change of chi2 per sample at 128 x 128 pixels, the lamp's scale fitted. Effects that imitate a nuisance
#: leave only strain in what is known of camera and lamp when these are fitted: 5, 10 and 17 standard deviations of it.
STRENGTHS: Mapping[str, float] = {"weak": 0.06, "medium": 1.0, "strong": 8.0}

#: Strain (the square) that counts as medium; strengths grow as its square.
_STRAIN = 100.0

_CLOSE = 0.02
_MOST_TRIALS = 40

#: Chi2 per sample of an applied effect.
Scale = Callable[[AppliedEffect], float]


def scale_of(model: Model, camera: Camera, settings: CaptureSettings, seed: int) -> Scale:
    """A function that tells an effect's chi2 per sample in the model's capture; one is made without it, and kept
    nowhere.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "capture"
        write_model_capture(place, model, camera, settings, seed, relative_error=5e-3)
        prepared = prepare(place, Model(model.scene))
        light = solved_light(prepared, model.render, model.effects)
        coarse = replace(model.render, noise=1.0)
        rendered = rendered_from(prepared, light, prepared.calibrated_camera, coarse, model.effects)
    predictor, used = rendered.predictor, rendered.used
    if predictor is None:
        raise InputError("--strength", "no compiled variant", "LLVM 16 or newer")
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
        if effect.id in PRIOR_EFFECTS:
            moved = effect.apply(camera) if effect.effect.stage == "camera" else camera
            brighter = float(effect.values["scale"]) - 1 if effect.id == "lamp-power" else 0.0
            strain = priors @ np.append(moved.parameters - camera.parameters, brighter)
            return (float(strain @ strain) / _STRAIN) ** 2
        # the product of two whose random numbers differ: a square would count their noise as strength
        first, second = (change(each, effect) for each in (predictor, again))
        return float(first @ second) / len(sigma)

    return scale


def at_strength(effect: AppliedEffect, wanted: float, scale: Scale) -> AppliedEffect | None:
    """The effect with the distance of its numbers from null scaled, all alike, until ``scale`` says ``wanted``.

    None where the bounds do not let it become that strong.
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
            reached = np.inf  # a lamp moved out of the ceiling: less will do
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
    """Numbers ``factor`` times as far from null, kept in bounds; an index in the square of its inverse."""
    result = {}
    for p in free:
        assert p.null is not None
        value = float(values[p.name])
        if np.isinf(p.null):
            result[p.name] = float(np.clip(value / np.sqrt(factor), p.low, p.high))
        else:
            result[p.name] = float(np.clip(p.null + factor * (value - p.null), p.low, p.high))
    return result
