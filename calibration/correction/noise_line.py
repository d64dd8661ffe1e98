"""Straight line of the variance of counts against charge, from repeats.

The sample variance of normal counts with f degrees of freedom has the density of chi-square times v / f, where v is
its expectation. Least squares with weights f / (2 v^2), repeated until v is that of the line itself, solve the
equations of maximum likelihood. The inverse of their normal matrix is the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray

from .repeat_light import with_steady_light

__all__ = [
    "ROUNDED_VARIANCE",
    "ROUNDING_VARIANCE",
    "UNKNOWN",
    "VarianceSamples",
    "fit_noise_line",
    "samples_of_repeats",
]

#: Variance of rounding to whole counts, DN^2.
ROUNDING_VARIANCE = 1.0 / 12.0
#: Variance of dark counts below which rounding dominates, DN^2: half way between two counts rounding alone gives 1/4.
#: The true variance then lies between that of rounding and this value (compare 0.24 in EMVA 1288).
ROUNDED_VARIANCE = 0.3
#: An unknown value and its standard deviation.
UNKNOWN = (0.0, np.inf)
#: Standard deviations beyond which a sample is a cosmic ray: normal noise exceeds it once in 2.6e7 samples.
_OUTLIER_SIGMAS = 5.5
#: Standard deviations that the mean of a pixel's repeats keeps from 0 and from saturation: no repeat is cut off there.
_MARGIN_SIGMAS = 6.0
#: Rounds of the fit at most.
_ROUNDS = 20
#: Relative change of the line at which the rounds end: a millionth of its standard deviation or less.
_CONVERGED = 1e-9


@dataclass(frozen=True, eq=False)
class VarianceSamples:
    """Variances of single pixels against their charge, of one table."""

    #: (n,) charge above bias, DN.
    charge: NDArray[np.float64]
    #: (n,) variance over repeats, DN^2.
    variance: NDArray[np.float64]
    #: Degrees of freedom of each variance, repeats - 1.
    degrees: int


def samples_of_repeats(
    stack: NDArray[np.uint16],
    bias: NDArray[np.float64],
    saturation: int,
    *,
    is_dark: bool = False,
    line: NDArray[np.float64] | None = None,
) -> VarianceSamples:
    """Charge and variance of the usable pixels of repeats.

    Parameters
    ----------
    stack
        (repeat, y, x) counts of two repeats or more, DN. Bright repeats that are copies of one frame give no samples.
    bias
        (y, x) level without charge, DN.
    saturation
        Count from which a pixel is saturated, DN.
    is_dark
        True for dark frames.
    line
        (floor, slope) of the variance, DN^2 and DN, for pictures with pixels at both ends of the counts. Pixels then
        take part by their mean, which keeps six standard deviations from either end, and where rounding does not
        decide their variance. None for a uniform field.

    Returns
    -------
    VarianceSamples
        One for each pixel; none for copies.
    """
    counts = stack.astype(float)
    if line is None:
        good = (stack.max(axis=0) < saturation) & (stack.min(axis=0) > 0)
    else:
        # a choice by single counts would leave out the pixels whose noise is large
        mean = counts.mean(axis=0)
        expected = np.maximum(line[0] + line[1] * (mean - bias), ROUNDING_VARIANCE)
        margin = _MARGIN_SIGMAS * np.sqrt(expected)
        good = (mean - margin > 0) & (mean + margin < saturation) & (expected > ROUNDED_VARIANCE)
    copied = not is_dark and bool((stack == stack[0]).all())
    if copied or not np.any(good):
        return VarianceSamples(np.zeros(0), np.zeros(0), stack.shape[0] - 1)
    if is_dark:
        counts -= (counts - counts.mean(axis=0))[:, good].mean(axis=1)[:, None, None]
    else:
        counts = with_steady_light(counts, good)
    charge = counts.mean(axis=0) - bias
    if is_dark:
        # The noise of the dark charge of a pixel is as large as the charge and would bias the slope of the line.
        # Since variance is linear in charge, the mean charge of the ordinary pixels can be used instead.
        middle = np.median(charge[good])
        spread = robust_sigma(charge[good] - middle)
        good &= np.abs(charge - middle) <= _OUTLIER_SIGMAS * max(spread, ROUNDING_VARIANCE)
        charge = np.full_like(charge, charge[good].mean())
    return VarianceSamples(charge[good], counts.var(axis=0, ddof=1)[good], stack.shape[0] - 1)


def fit_noise_line(
    samples: Sequence[VarianceSamples], floor: tuple[float, float] = UNKNOWN, slope: tuple[float, float] = UNKNOWN
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Straight line of variance against charge by maximum likelihood.

    The weights come from the fitted line. Weights from the samples would bias the fit low.

    Parameters
    ----------
    samples
        Charges and variances.
    floor
        Prior value of the variance without charge and its standard deviation, DN^2.
    slope
        Prior value of the variance per charge and its standard deviation, DN.

    Returns
    -------
    NDArray
        (2,) floor and slope, DN^2 and DN.
    NDArray
        (2, 2) their covariance.
    """
    prior_mean, prior_sigma = np.transpose([floor, slope])
    prior_weight = np.diag(prior_sigma**-2.0)
    charge = np.concatenate([s.charge for s in samples])
    variance = np.concatenate([s.variance for s in samples])
    degrees = np.concatenate([np.full(s.charge.size, float(s.degrees)) for s in samples])
    line: NDArray[np.float64] = np.ones(2)
    keep = np.ones(charge.size, bool)
    normal: NDArray[np.float64] = np.eye(2)
    for _ in range(_ROUNDS):
        model = np.maximum(line[0] + line[1] * charge, ROUNDING_VARIANCE)
        weight = keep * degrees / (2 * model**2)
        cross = np.sum(weight * charge)
        normal = prior_weight + np.array([[weight.sum(), cross], [cross, np.sum(weight * charge**2)]])
        weighted_sums = np.array([np.sum(weight * variance), np.sum(weight * charge * variance)])
        before, line = line, np.linalg.solve(normal, weighted_sums + prior_weight @ prior_mean)
        keep = variance < _OUTLIER_SIGMAS**2 * np.maximum(line[0] + line[1] * charge, ROUNDING_VARIANCE)
        if np.allclose(line, before, rtol=_CONVERGED, atol=0):
            break
    return line, np.asarray(np.linalg.inv(normal), np.float64)
