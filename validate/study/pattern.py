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

#: Largest factor on the first steps: the change is then still nearly proportional to them.
_MOST = 64.0

#: Smallest factor on the first steps, for numbers of coarse steps.
_LEAST = 1 / 16


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

    first = change_at(at(_FIRST_STEPS))
    size = float(np.nanpercentile(np.abs(first), 99))
    if not size > 0:
        return Pattern(parameter, at(_FIRST_STEPS), first)
    steps = _FIRST_STEPS * float(np.clip(_VISIBLE_SIGMA / size, _LEAST, _MOST))
    return Pattern(parameter, at(steps), change_at(at(steps)))
