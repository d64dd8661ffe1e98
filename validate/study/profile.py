"""Chi-square over one number of an effect, the others held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.effects import Parameter
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import ArrayLike, NDArray

__all__ = ["Profile", "chi2_profile"]

#: Number of values across the complete range: a parabola and its shoulders are smooth with them.
_WIDE = 15

#: Number of further values within a few standard deviations of a fitted value.
_NEAR = 9

#: Half the width of the near values, standard deviations: chi-square rises by 16 there, if the model is complete.
_NEAR_SIGMA = 4.0

#: Distance beyond the present value, as a part of its distance from null: the null value and the far side are in range.
_BEYOND = 1.25

#: Least half width of the range, steps of the parameter; each changes the picture by a fraction of its noise.
_FEWEST_STEPS = 8


@dataclass(frozen=True, eq=False)
class Profile:
    """Reduced chi-square over one number of an effect."""

    #: Identifier of the effect.
    effect: str
    #: The parameter.
    parameter: Parameter
    #: (n,) values of the parameter, in its unit, in the order of its coordinate.
    values: NDArray[np.float64]
    #: (captures, n) reduced chi-square of each capture.
    chi2_per_dof: NDArray[np.float64]

    def best(self, capture: int = 0) -> float:
        """Value of the lowest computed chi-square.

        Parameters
        ----------
        capture
            Index of the capture, from 0.

        Returns
        -------
        float
            The value, in the unit of the parameter.
        """
        return float(self.values[np.argmin(self.chi2_per_dof[capture])])


def chi2_profile(
    effect: str,
    parameter: Parameter,
    value: float,
    sigma: float | None,
    chi2_at: Callable[[float], tuple[float, ...]],
    progress: Progress = NO_PROGRESS,
) -> Profile:
    """Chi-square from null to beyond the present value, with more values near a fitted one.

    Parameters
    ----------
    effect
        Identifier of the effect.
    parameter
        The parameter, a number.
    value
        Present value, in the parameter's unit.
    sigma
        Standard deviation of the present value; None if it was not fitted.
    chi2_at
        Function of a value that returns the reduced chi-square of each capture.
    progress
        Receiver of the completed share.

    Returns
    -------
    Profile
        Values and chi-square.
    """
    coordinates = _coordinates(parameter, value, sigma)
    values = np.unique([parameter.from_coordinate(c) for c in coordinates])
    values = values if parameter.scale == "linear" else values[::-1]
    rows = []
    for index, each in enumerate(values):
        progress.part(index / len(values))
        rows.append(chi2_at(float(each)))
    return Profile(effect, parameter, values, np.array(rows, float).T)


def _coordinates(parameter: Parameter, value: float, sigma: float | None) -> NDArray[np.float64]:
    """Coordinates of the values, within the bounds."""
    present = parameter.to_coordinate(value)
    low, high = parameter.coordinate_bounds
    from_null = abs(present - parameter.null_coordinate) if parameter.null is not None else (high - low) / 4
    near = 0.0 if not sigma else _NEAR_SIGMA * sigma / parameter.deviation(value, 1.0)
    reach = max(_BEYOND * from_null, _FEWEST_STEPS * parameter.step, near)
    parts: list[ArrayLike] = [np.linspace(max(low, present - reach), min(high, present + reach), _WIDE), [present]]
    if near and np.isfinite(near):
        parts.append(np.linspace(max(low, present - near), min(high, present + near), _NEAR))
    return np.concatenate([np.ravel(part) for part in parts])
