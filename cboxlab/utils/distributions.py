"""Tail probabilities and quantiles of test statistics.

They are those of `scipy.stats`, whose import takes longer than many a command: it builds all its distributions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

__all__ = [
    "NORMAL_OVER_MEDIAN",
    "chi2_quantile",
    "chi2_tail",
    "fisher_quantile",
    "fisher_tail",
    "normal_density",
    "normal_quantile",
    "robust_sigma",
    "student_quantile",
    "student_tail",
]

#: Standard deviation of normal deviations over the median of their absolute values.
NORMAL_OVER_MEDIAN = 1.4826


def chi2_tail(value: ArrayLike, degrees: ArrayLike) -> Any:
    """Probability that chi-square exceeds a value.

    Parameters
    ----------
    value
        The value.
    degrees
        Degrees of freedom.

    Returns
    -------
    float or NDArray
        The probability.
    """
    return special.chdtrc(degrees, value)


def chi2_quantile(tail: ArrayLike, degrees: ArrayLike) -> Any:
    """Value that chi-square exceeds with a probability.

    Parameters
    ----------
    tail
        The probability.
    degrees
        Degrees of freedom.

    Returns
    -------
    float or NDArray
        The value.
    """
    return special.chdtri(degrees, tail)


def robust_sigma(deviations: ArrayLike) -> float:
    """Standard deviation of normal deviations, which outliers hardly change.

    `scipy.stats.median_abs_deviation` subtracts the median first, and takes longer to import.

    Parameters
    ----------
    deviations
        Deviations from their centre.

    Returns
    -------
    float
        In their unit.
    """
    return NORMAL_OVER_MEDIAN * float(np.median(np.abs(deviations)))


def student_tail(value: ArrayLike, degrees: ArrayLike) -> Any:
    """Probability that Student's t exceeds a value.

    Parameters
    ----------
    value
        The value.
    degrees
        Degrees of freedom.

    Returns
    -------
    float or NDArray
        The probability.
    """
    return special.stdtr(degrees, -np.asarray(value))


def student_quantile(tail: ArrayLike, degrees: ArrayLike) -> Any:
    """Value that Student's t exceeds with a probability.

    Parameters
    ----------
    tail
        The probability.
    degrees
        Degrees of freedom.

    Returns
    -------
    float or NDArray
        The value.
    """
    return -special.stdtrit(degrees, tail)


def fisher_tail(value: ArrayLike, above: ArrayLike, below: ArrayLike) -> Any:
    """Probability that Fisher's F exceeds a value.

    Parameters
    ----------
    value
        The value.
    above, below
        Degrees of freedom of numerator and denominator.

    Returns
    -------
    float or NDArray
        The probability.
    """
    return special.fdtrc(above, below, value)


def fisher_quantile(tail: ArrayLike, above: ArrayLike, below: ArrayLike) -> Any:
    """Value that Fisher's F exceeds with a probability.

    Parameters
    ----------
    tail
        The probability.
    above, below
        Degrees of freedom of numerator and denominator.

    Returns
    -------
    float or NDArray
        The value.
    """
    return special.fdtri(above, below, 1.0 - np.asarray(tail))


def normal_quantile(tail: ArrayLike) -> Any:
    """Value that a standard normal variable exceeds with a probability.

    Parameters
    ----------
    tail
        The probability.

    Returns
    -------
    float or NDArray
        The value.
    """
    return -special.ndtri(tail)


def normal_density(value: ArrayLike) -> Any:
    """Density of a standard normal variable.

    Parameters
    ----------
    value
        The value.

    Returns
    -------
    float or NDArray
        The density.
    """
    return np.exp(-(np.asarray(value) ** 2) / 2.0) / np.sqrt(2 * np.pi)
