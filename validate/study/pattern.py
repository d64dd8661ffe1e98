"""Changes of the predicted picture by the numbers of an effect that is not in the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.effects import Parameter
from numpy.typing import NDArray

__all__ = ["Pattern", "pattern_of"]

#: Steps from null at which the size of a change is measured first.
_FIRST_STEPS = 4

#: Change of the most changed hundredth of the samples, standard deviations: strong enough to be seen on the scale of
#: the difference.
_VISIBLE_SIGMA = 3.0

#: Largest factor on the first steps, so that no number goes far beyond sizes that matter.
_MOST = 64.0

#: Smallest factor on the first steps, for numbers of coarse steps.
_LEAST = 1 / 16

#: Most changes of the size: blur grows with the square of its number, which the second change takes into account.
_ROUNDS = 3

#: Factor within which a size is visible enough.
_CLOSE = 1.2


@dataclass(frozen=True, eq=False)
class Pattern:
    """Change of a predicted picture by one number of an effect."""

    #: The parameter.
    parameter: Parameter
    #: Value of the parameter at which the change is shown, in its unit.
    value: float
    #: (band, y, x) change over the standard deviation of the difference.
    change_sigma: NDArray[np.float64]


def pattern_of(parameter: Parameter, change_at: Callable[[float], NDArray[np.float64]]) -> Pattern:
    """Pattern of a number at a value where it is as strong as three standard deviations.

    Parameters
    ----------
    parameter
        The parameter, a number. Without null value its example is taken, or the first starting value.
    change_at
        Function of a value that returns the (band, y, x) change over the standard deviation.

    Returns
    -------
    Pattern
        The change at that value.
    """
    if parameter.null is None:
        value = parameter.starting_values[0] if parameter.example is None else float(parameter.example)
        return Pattern(parameter, value, change_at(value))

    def at(steps: float) -> float:
        return parameter.from_coordinate(parameter.null_coordinate + steps * parameter.coordinate_step)

    def measured(steps: float) -> tuple[Pattern, float]:
        change = change_at(at(steps))
        return Pattern(parameter, at(steps), change), float(np.nanpercentile(np.abs(change), 99))

    steps, power = float(_FIRST_STEPS), 1.0
    pattern, size = measured(steps)
    for _ in range(_ROUNDS):
        if not size > 0 or 1 / _CLOSE < size / _VISIBLE_SIGMA < _CLOSE:
            break
        factor = (_VISIBLE_SIGMA / size) ** (1 / power)
        next_steps = float(np.clip(steps * factor, _FIRST_STEPS * _LEAST, _FIRST_STEPS * _MOST))
        if next_steps == steps:
            break
        before = np.log([steps, size])
        steps = next_steps
        pattern, size = measured(steps)
        if size > 0:
            power = float(np.clip((np.log(size) - before[1]) / (np.log(steps) - before[0]), 0.5, 4.0))
    return pattern
