"""Correlations of the fitted numbers of a model's effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.effects import AppliedEffect
from numpy.typing import NDArray

from ..diagnose import nuisance_priors
from .prediction import Base, Prediction, predict

__all__ = ["HARDLY_DISTINGUISHED", "Correlations", "fitted_correlations"]

#: Size of a correlation above which two numbers are hardly distinguished. At 0.9 each of their errors is 2.3 times
#: that of the number alone.
_STRONG = 0.9

#: Sentence on two numbers of a strong correlation.
HARDLY_DISTINGUISHED = "This capture hardly distinguishes these two numbers"


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations of fitted numbers, camera and lamp free within their priors."""

    #: Effect and parameter of each number.
    names: tuple[str, ...]
    #: (n, n) correlations, -1 to 1; NaN for a number on which the picture does not depend.
    values: NDArray[np.float64]

    @property
    def sentences(self) -> tuple[str, ...]:
        """A sentence for each pair of a strong correlation."""
        first, second = np.nonzero(np.triu(np.abs(np.nan_to_num(self.values)) > _STRONG, 1))
        return tuple(
            f"{self.names[i]} and {self.names[j]} (r = {_signed(self.values[i, j])}): {HARDLY_DISTINGUISHED}."
            for i, j in zip(first, second, strict=True)
        )


def _signed(correlation: float) -> str:
    """Text with a sign; a minus sign is no hyphen."""
    return f"{correlation:+.2f}".replace("-", "−")


def fitted_correlations(bases: Sequence[Base], effects: Sequence[AppliedEffect]) -> Correlations | None:
    """Correlations of the fitted numbers by the captures' noise.

    The picture is predicted with each number one standard deviation from its value, camera and lamp fitted again. The
    differences, and the motions of camera and lamp against their priors, give the information on the numbers.

    Parameters
    ----------
    bases
        Validation of each capture, with a predictor.
    effects
        Effects of the model, those fitted with standard deviations.

    Returns
    -------
    Correlations | None
        None if fewer than two numbers are fitted.
    """
    numbers = [
        (index, name, sigma)
        for index, effect in enumerate(effects)
        for name, sigma in effect.sigma.items()
        if np.isfinite([effect.values[name], sigma]).all() and sigma > 0
    ]
    if len(numbers) < 2:
        return None
    information = np.zeros((len(numbers), len(numbers)))
    for base in bases:
        still = predict(base, effects, draft=True)
        rows = np.array([_change(base, still, effects, *number) for number in numbers])
        information += rows @ rows.T
    sensitive = np.diag(information) > 0
    values = np.full(information.shape, np.nan)
    size = np.sqrt(np.diag(information)[sensitive])
    covariance = np.linalg.pinv(
        information[np.ix_(sensitive, sensitive)] / np.outer(size, size), rcond=1e-10, hermitian=True
    )
    error = np.sqrt(np.diag(covariance))
    values[np.ix_(sensitive, sensitive)] = np.clip(covariance / np.outer(error, error), -1, 1)
    labels = [{p.name: p.label for p in effect.effect.parameters} for effect in effects]
    return Correlations(tuple(f"{effects[i].id} {labels[i][name]}" for i, name, _ in numbers), values)


def _change(
    base: Base, still: Prediction, effects: Sequence[AppliedEffect], index: int, name: str, sigma: float
) -> NDArray[np.float64]:
    """Change of all samples and of camera and lamp, over their sigma, by one sigma of a number.

    Signals are those with camera and lamp fitted.
    """
    effect = effects[index]
    parameter = next(p for p in effect.effect.numbers if p.name == name)
    value = float(effect.values[name])
    step = sigma if value + sigma <= parameter.high else -sigma
    moved = [*effects]
    moved[index] = replace(effect, values={**effect.values, name: value + step})
    stepped = predict(base, moved, draft=True)
    prepared, used = base.validation.prepared, base.rendered.used
    before, after = (
        prediction.rendered.fit.missed(prepared.expected_camera(prediction.effects)).vector
        for prediction in (still, stepped)
    )
    priors = nuisance_priors(prepared.expected_camera(effects), prepared.lamp_sigma) @ (before - after)
    return np.concatenate([((stepped.signal - still.signal) / still.sigma)[used], priors]) * np.sign(step)
