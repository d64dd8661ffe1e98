"""Light that changes between repeats: its size, and repeats scaled to one mean.

A change of the light multiplies what a frame has above its dark level. Where the field is not uniform, a difference
between repeats then follows the picture, and its variance adds to the temporal noise. With d_k the deviation of
repeat k from the mean picture m,

    d_k = a_k + b_k (m - <m>),

where <m> is the mean over pixels and b_k the relative change of the light. No dark level is needed. All b_k are 0 where
the light is steady, and for a uniform field they need not be known: a shift by a_k is then the same as a scale.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import fisher_tail
from numpy.typing import NDArray

__all__ = ["LIGHT_CHANGE_NOTED", "LIGHT_FALSE_ALARM", "light_change", "with_steady_light"]

#: Relative change of the light between repeats from which it is noted and corrected: below it, it moves a gain of two
#: vignetted frames of 65,000 pixels by less than half a standard deviation.
LIGHT_CHANGE_NOTED = 0.003
#: Probability with which noise alone passes for a change of the light, for each exposure.
LIGHT_FALSE_ALARM = 1e-4
#: Robust standard deviations beyond which a pixel's deviation is a cosmic ray.
_OUTLIER_SIGMAS = 5.5
#: Standard deviation of a normal distribution over its median absolute deviation.
_MAD_TO_SIGMA = 1.4826


def _without_outliers(deviation: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(repeat, n) False for cosmic rays: deviations far beyond those of the other pixels."""
    offset = deviation - np.median(deviation, axis=1, keepdims=True)
    spread = _MAD_TO_SIGMA * np.median(np.abs(offset), axis=1, keepdims=True)
    return np.abs(offset) <= _OUTLIER_SIGMAS * np.maximum(spread, np.sqrt(1 / 12))


def _is_significant(sizes: NDArray[np.float64], variance: float, degrees: int) -> bool:
    """Whether one size per repeat varies by more than noise of that variance explains."""
    repeats = sizes.size
    statistic = float(np.sum((sizes - sizes.mean()) ** 2)) / (repeats - 1)
    if variance <= 0:
        return statistic > 0
    return bool(fisher_tail(statistic / variance, repeats - 1, degrees) < LIGHT_FALSE_ALARM)


def light_change(counts: NDArray[np.float64], dark: NDArray[np.float64], good: NDArray[np.bool_]) -> float:
    """Relative change of the light between repeats, as far as it is larger than noise.

    Parameters
    ----------
    counts
        (repeat, y, x) counts of two repeats or more, DN.
    dark
        (y, x) dark level at their exposure, DN.
    good
        (y, x) True for pixels used.

    Returns
    -------
    float
        Largest minus smallest mean above dark, over their mean. 0 where noise explains it, or without light: sound
        repeats differ by more with a probability of LIGHT_FALSE_ALARM.
    """
    mean = counts.mean(axis=0)
    level = float((mean - dark)[good].mean()) if good.any() else 0.0
    deviation = (counts - mean)[:, good]
    if level <= 0 or deviation.shape[1] < 2:
        return 0.0
    usual = _without_outliers(deviation)
    sizes = np.array([row[use].mean() for row, use in zip(deviation, usual, strict=True)])
    repeats, pixels = deviation.shape
    rest = np.where(usual, deviation - sizes[:, None], 0.0)
    degrees = (repeats - 1) * (pixels - 1)
    variance = float(np.sum(rest**2)) / degrees
    if not _is_significant(sizes, variance / pixels, degrees):
        return 0.0
    return float(np.ptp(sizes)) / level


def with_steady_light(counts: NDArray[np.float64], good: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Repeats with the changes of their light removed; the mean over repeats stays the same.

    Each repeat is shifted to the mean of all. Where the light changes by LIGHT_CHANGE_NOTED or more, it is scaled.

    Parameters
    ----------
    counts
        (repeat, y, x) counts of two repeats or more, DN.
    good
        (y, x) True for pixels from which the changes are measured.

    Returns
    -------
    NDArray
        (repeat, y, x) counts, DN.
    """
    mean = counts.mean(axis=0)
    steady = counts - (counts - mean)[:, good].mean(axis=1)[:, None, None]
    slopes = _slopes(steady - mean, mean, good)
    if slopes is None:
        return steady
    picture = mean - mean[good].mean()
    return steady - slopes[:, None, None] * picture


def _slopes(
    deviation: NDArray[np.float64], mean: NDArray[np.float64], good: NDArray[np.bool_]
) -> NDArray[np.float64] | None:
    """(repeat,) relative change of the light b_k; None for steady light and for a uniform field."""
    picture = mean[good] - mean[good].mean()
    rows = deviation[:, good]
    lever = float(np.sum(picture**2))
    repeats, pixels = rows.shape
    if lever <= 0 or pixels < 3:
        return None
    usual = _without_outliers(rows)
    slopes = np.array(
        [np.sum(row[k] * picture[k]) / np.sum(picture[k] ** 2) for row, k in zip(rows, usual, strict=True)]
    )
    slopes -= slopes.mean()
    rest = np.where(usual, rows - slopes[:, None] * picture, 0.0)
    degrees = (repeats - 1) * (pixels - 2)
    variance = float(np.sum(rest**2)) / degrees
    if np.ptp(slopes) < LIGHT_CHANGE_NOTED or not _is_significant(slopes, variance / lever, degrees):
        return None
    return slopes
