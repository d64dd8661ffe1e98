"""Response to one setting at a time: test of proportionality, and departures from it.

The sensor equation (Pattanaik et al. 1997, eq. 3) states S = a x with x the exposure time, the inverse square
of the f-number, the inverse square of the image distance, or the photon flux. Three departures are
distinguished, with v = a x the proportional signal:

- offset, S = a (x + x0): a shutter that opens longer, stray light, a black level
- bend, S = v + b v^2 / full scale: a nonlinear converter or amplifier
- exponent, S = a x^(1 + p): settings with wrong nominal values
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import chi2_tail
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

__all__ = ["LAWS", "REPEATABILITY", "Departure", "Law", "ResponseFit", "fit_response"]

#: Assumed relative scatter of shutter and lamp between exposures, in addition to the noise model.
REPEATABILITY = 0.001
#: Probability of the chi-square below which proportionality is rejected.
_SIGNIFICANCE = 1e-3


@dataclass(frozen=True)
class Law:
    """The law signal proportional to setting ** power."""

    #: Name of the setting, for messages.
    setting: str
    #: Unit of the setting.
    unit: str
    #: Power of the setting.
    power: int
    #: Name of an offset of this law, for messages.
    offset_name: str


#: By key, the four laws of the paper's figures 1 to 4.
LAWS: Mapping[str, Law] = {
    "exposure": Law("exposure time", "s", 1, "shutter offset"),
    "f_number": Law("f-number", "1", -2, "signal offset"),
    "image_distance": Law("image distance", "mm", -2, "signal offset"),
    "flux": Law("photon flux", "1 s^-1", 1, "signal offset"),
}


@dataclass(frozen=True)
class Departure:
    """A departure from proportionality with its size."""

    #: "offset", "bend" or "exponent".
    kind: str
    #: Offset: x0 in s, or a x0 in DN where the setting is no time. Bend: b. Exponent: p times the power of the law.
    size: float
    #: Standard deviation of the size, in its unit.
    sigma: float
    #: Largest relative effect on a signal of the series.
    largest: float
    #: Description with size and unit.
    text: str


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A series of one setting, the fit S = a x, and the departure from it."""

    #: The law tested.
    law: Law
    #: (n,) values set, in the unit of the law.
    setting: NDArray[np.float64]
    #: (n,) mean counts above dark, DN.
    signal: NDArray[np.float64]
    #: (n,) standard deviations of the signals by noise and REPEATABILITY, DN.
    sigma: NDArray[np.float64]
    #: a, DN per unit of x = setting ** power.
    slope: float
    #: Standard deviation of a, the factor common to all signals included.
    slope_sigma: float
    #: (n,) relative residual (signal - a x) / (a x).
    residual: NDArray[np.float64]
    #: Chi-square of proportionality, with n - 1 degrees of freedom.
    chi2: float
    #: Probability of a chi-square as large or larger.
    probability: float
    #: The departure that reduces the misfit most; None if proportionality holds or none of the three helps.
    departure: Departure | None
    #: (n,) relative residual with the departure in the model.
    residual_after: NDArray[np.float64]
    #: The result, one sentence.
    verdict: str


#: Signals (n,) by the slope and one further, scaled parameter.
Model = Callable[[float, float], NDArray[np.float64]]


def _models(x: NDArray[np.float64], full_scale_dn: float) -> dict[str, Model]:
    """By kind of departure, the signal (n,) by the slope and one further, scaled parameter."""
    middle = float(np.exp(np.mean(np.log(x))))

    def bent(slope: float, bend: float) -> NDArray[np.float64]:
        straight = slope * x
        return straight * (1 + bend * straight / full_scale_dn)

    return {
        "offset": lambda slope, offset: slope * (x + offset * float(x.min())),
        "bend": bent,
        "exponent": lambda slope, power: slope * x * (x / middle) ** power,
    }


def fit_response(
    law: Law,
    setting: ArrayLike,
    signal: ArrayLike,
    sigma: ArrayLike,
    full_scale_dn: float,
    frames: ArrayLike = 1,
    shared_sigma: float = 0.0,
) -> ResponseFit:
    """Fit S = a x by weighted least squares; if the fit is rejected, find the best departure.

    A departure is reported for four points or more, if it halves the chi-square.

    Parameters
    ----------
    law
        The law tested, of LAWS.
    setting
        (n,) values set, n >= 3, above 0, in the unit of the law.
    signal
        (n,) mean signals above dark, above 0, DN.
    sigma
        (n,) standard deviations of the signals by noise alone, DN.
    full_scale_dn
        Largest count, to which a bend refers, DN.
    frames
        Repeats averaged for each point, scalar or (n,).
    shared_sigma
        Relative uncertainty of a factor common to all signals; it affects only the slope.

    Returns
    -------
    ResponseFit
        In the order of the settings given.

    Raises
    ------
    ValueError
        For fewer than three points, or for settings or signals that are not above 0.
    """
    value, level = np.asarray(setting, float), np.asarray(signal, float)
    if value.size < 3 or np.any(value <= 0) or np.any(level <= 0):
        raise ValueError("a response needs at least three settings and signals above 0")
    spread = np.hypot(np.asarray(sigma, float), REPEATABILITY * level / np.sqrt(np.asarray(frames, float)))
    x = value**law.power
    weight = 1 / spread**2
    slope = float(np.sum(weight * x * level) / np.sum(weight * x**2))
    misfit = float(np.sum(weight * (level - slope * x) ** 2))
    probability = float(chi2_tail(misfit, value.size - 1))
    residual = level / (slope * x) - 1
    departure, residual_after = None, residual
    if probability < _SIGNIFICANCE and value.size > 3:
        departure, residual_after, remaining_chi2 = _best_departure(law, x, level, spread, slope, full_scale_dn)
        if remaining_chi2 > 0.5 * misfit:
            departure, residual_after = None, residual
    return ResponseFit(
        law,
        value,
        level,
        spread,
        slope,
        float(np.hypot(np.sum(weight * x**2) ** -0.5, shared_sigma * slope)),
        residual,
        misfit,
        probability,
        departure,
        residual_after,
        _verdict(law, residual, probability, departure, residual_after),
    )


def _best_departure(
    law: Law,
    x: NDArray[np.float64],
    level: NDArray[np.float64],
    spread: NDArray[np.float64],
    slope: float,
    full_scale_dn: float,
) -> tuple[Departure, NDArray[np.float64], float]:
    """Departure of least chi-square, relative residual (n,) with it, and that chi-square."""
    fits = {}
    for kind, model in _models(x, full_scale_dn).items():
        fit = least_squares(
            lambda p, model=model: (model(slope * p[0], p[1]) - level) / spread, [1.0, 0.0], x_scale=[1, 0.01]
        )
        fits[kind] = fit, model(slope * fit.x[0], fit.x[1])
    kind = min(fits, key=lambda name: fits[name][0].cost)
    fit, predicted = fits[kind]
    remaining_chi2 = 2 * float(fit.cost)
    # The sigma is scaled up if a misfit remains.
    growth = max(1.0, remaining_chi2 / max(level.size - 2, 1))
    sigma = float(np.sqrt(np.linalg.inv(fit.jac.T @ fit.jac)[1, 1] * growth))
    size = float(fit.x[1])
    effect = predicted / (slope * fit.x[0] * x) - 1
    if kind == "offset":
        unit = float(x.min()) if law.power == 1 and law.unit == "s" else slope * fit.x[0] * float(x.min())
        size, sigma = size * unit, sigma * unit
        name = f"{law.offset_name} {size:+.3g} +- {sigma:.2g} {'s' if law.unit == 's' else 'DN'}"
        if law.unit == "s":
            # One series cannot distinguish these two; brackets with bright and dark tiles can.
            name += f" (or a signal offset of {size * slope * fit.x[0]:+.2g} DN)"
    elif kind == "bend":
        name = f"bend {100 * size:+.3g} +- {100 * sigma:.2g} % of the signal at full scale"
    else:
        power = law.power * (1 + size)
        sigma = abs(law.power) * sigma
        size = law.power * size
        name = f"exponent {power:.4f} +- {sigma:.4f} instead of {law.power}"
    departure = Departure(kind, size, sigma, float(np.abs(effect).max()), name)
    return departure, level / predicted - 1, remaining_chi2


def _verdict(
    law: Law,
    residual: NDArray[np.float64],
    probability: float,
    departure: Departure | None,
    after: NDArray[np.float64],
) -> str:
    """One sentence: whether the law holds, the largest deviation, and what departs from it."""
    how = "proportional to" if law.power == 1 else "inverse square of"
    largest = f"largest deviation {100 * np.abs(residual).max():.2g} %"
    if probability >= _SIGNIFICANCE:
        return f"{how} {law.setting}: holds, {largest}"
    if departure is None:
        return f"{how} {law.setting}: does not hold, {largest}; no single departure explains it"
    rest = f"{100 * np.abs(after).max():.2g} % remains"
    return f"{how} {law.setting}: does not hold, {largest}; {departure.text} ({rest})"
