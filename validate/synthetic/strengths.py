"""Strength of an effect (chi2 per sample that it changes), and effects of a given strength."""

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
#: only show as a deviation of the fitted camera and lamp from their priors: 5, 10 and 17 standard deviations from weak
#: to strong.
STRENGTHS: Mapping[str, float] = {"faint": 0.0024, "weak": 0.06, "medium": 1.0, "strong": 8.0}

#: Squared deviation from the priors of a medium effect that only priors judge; the strength grows with its square.
_MEDIUM_PULL_SQ = 100.0

#: Relative deviation from the strength asked for at which a search ends.
_RELATIVE_TOLERANCE = 0.02

#: Largest number of trials of a search.
_MAX_TRIALS = 40

#: Chi2 per sample of an applied effect.
Scale = Callable[[AppliedEffect], float]


def scale_of(model: Model, camera: Camera, settings: CaptureSettings, seed: int) -> Scale:
    """A function that computes an effect's chi2 per sample in the model's capture.

    The capture is a temporary one without the effect. The change is a product of two estimates with independent random
    numbers, since the square of one would be biased by its noise.

    Parameters
    ----------
    model
        Model of the capture.
    camera
        The true camera.
    settings
        Settings of the simulated laboratory.
    seed
        Repeats the capture.

    Returns
    -------
    Scale
        Chi2 per sample of an effect.

    Raises
    ------
    InputError
        Without a compiled variant.
    """
    variant.require_compiled("strength")
    with temporary_folder() as folder:
        capture_folder = folder / "capture"
        write_model_capture(capture_folder, model, camera, settings, seed, relative_error=5e-3)
        prepared = prepare(load_capture(capture_folder), Model(model.scene))
        light = solved_light(prepared, model.render, model.effects)
        coarse = replace(model.render, noise=1.0)
        rendered = rendered_from(prepared, light, prepared.calibrated_camera, coarse, model.effects)
    predictor, used = rendered.predictor, rendered.used
    resampled = predictor.resampled()
    base = predictor.signal(model.effects)
    sigma = np.sqrt(prepared.calibration.predicted_variance(base)[used])
    level: NDArray[np.float64] = base[used] / sigma
    level /= np.linalg.norm(level)

    priors = nuisance_priors(prepared.calibrated_camera, prepared.lamp_sigma)

    def change(with_predictor: Predictor, effect: AppliedEffect) -> NDArray[np.float64]:
        moved = (with_predictor.signal((*model.effects, effect)) - with_predictor.signal(model.effects))[used] / sigma
        return np.asarray(moved - level * (level @ moved))

    def scale(effect: AppliedEffect) -> float:
        if judged_by_priors(effect, camera):
            lamps = (
                scene.lamp_radiance(WAVELENGTH_NM).sum()
                for scene in (after_stage(prepared.scene, (effect,), "scene"), prepared.scene)
            )
            brighter = float(np.divide(*lamps)) - 1
            pull = priors @ Nuisances(displacement(camera, (), (effect,)), brighter).vector
            return (float(pull @ pull) / _MEDIUM_PULL_SQ) ** 2
        first, second = (change(each, effect) for each in (predictor, resampled))
        return float(first @ second) / len(sigma)

    return scale


def at_strength(effect: AppliedEffect, target: float, scale: Scale) -> AppliedEffect | None:
    """The effect with its numbers scaled to a given strength.

    The distances of all numbers from null are scaled by a common factor. Chi2 grows about as its square; where that
    leads out of the factors tried, their logarithms are bisected.

    Parameters
    ----------
    effect
        Effect with numbers of any strength.
    target
        Chi2 per sample asked for.
    scale
        Chi2 per sample of an effect; an InputError counts as too strong.

    Returns
    -------
    AppliedEffect or None
        None where the bounds do not allow this strength. As it is where no number is free.
    """
    free = [p for p in effect.effect.numbers if p.null is not None]
    if not free:
        return effect
    low, high, factor = 0.0, np.inf, 1.0
    for _ in range(_MAX_TRIALS):
        trial = AppliedEffect(effect.effect, {**effect.values, **_scaled(free, effect.values, factor)})
        try:
            chi2_per_sample = scale(trial)
        except InputError:
            chi2_per_sample = np.inf  # not possible (e.g. a lamp outside the ceiling): reduce
        if abs(chi2_per_sample / target - 1) < _RELATIVE_TOLERANCE:
            return trial
        if chi2_per_sample < target:
            if all(trial.values[p.name] in (p.low, p.high) for p in free):
                return None
            low = factor
        else:
            high = factor
        by_square = factor * float(np.sqrt(target / chi2_per_sample)) if chi2_per_sample > 0 else 0.0
        if low < by_square < high:
            factor = by_square
        elif np.isinf(high):
            factor *= 2.0
        else:
            factor = np.sqrt(max(low, 1e-4 * high) * high)
        if high / max(low, 1e-9) < 1 + 1e-3:
            return None
    return None


def _scaled(free: list[Parameter], values: Mapping[str, str | float], factor: float) -> dict[str, float]:
    """Numbers with ``factor`` times the distance from null, clipped to their bounds."""
    result = {}
    for p in free:
        distance = p.to_coordinate(float(values[p.name])) - p.null_coordinate
        result[p.name] = p.from_coordinate(float(np.clip(p.null_coordinate + factor * distance, *p.coordinate_bounds)))
    return result
