"""Light that changes between repeats: its size, and repeats scaled to one mean.

A change of the light multiplies what a frame has above its dark level. Where the field is not uniform, a difference
between repeats then follows the picture, and its variance adds to the temporal noise. With d_k the deviation of
repeat k from the mean picture m,

    d_k = a_k + b_k (m - <m>),

where <m> is the mean over pixels and b_k the relative change of the light. No dark level is needed. All b_k are 0 where
the light is steady, and for a uniform field they need not be known: a shift by a_k is then the same as a scale.

Cosmic rays are left out by their distance from this line, in standard deviations of pixels as bright. In those of all
pixels, a bright lamp in a dark scene would be left out with them.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import NORMAL_OVER_MEDIAN, fisher_tail
from numpy.typing import NDArray

__all__ = ["LIGHT_CHANGE_NOTED", "LIGHT_FALSE_ALARM", "WARM_UP_REPEATS", "light_change", "with_steady_light"]

#: Relative change of the light between repeats from which it is noted and corrected: below it, it moves a gain of two
#: vignetted frames of 65,000 pixels by less than half a standard deviation.
LIGHT_CHANGE_NOTED = 0.003
#: Probability with which noise alone passes for a change of the light, for each exposure.
LIGHT_FALSE_ALARM = 1e-4
#: Repeats beyond the first of each exposure, of all bands together, by which a lamp that warms up differs from one that
#: trembles, at least. Three are explained by a trembling of 0.3 %. With four, as in four bands of two, a warm-up of
#: 10 % in 0.8 minutes is seen in 9 of 12 captures; with six of 3 % in 12 of 12.
WARM_UP_REPEATS = 4
#: Robust standard deviations beyond which a pixel's deviation is a cosmic ray.
_OUTLIER_SIGMAS = 5.5
#: Most fits without outliers, each judged by the fit before: a change of 26 % is then measured to 0.1 % of itself.
_ROUNDS = 4


def _without_outliers(rest: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(repeat, n) False for cosmic rays: deviations far beyond the noise of pixels as bright.

    The noise is a line of variance against the mean count (n,), through the medians of its darker and brighter half.
    """
    offset = rest - np.median(rest, axis=1, keepdims=True)
    bright = mean > np.median(mean)
    if not bright.any():
        bright = np.ones(mean.size, bool)
    low, high = mean[~bright].mean() if not bright.all() else mean.mean(), mean[bright].mean()
    limits = np.empty_like(rest)
    for row, limit in zip(offset, limits, strict=True):
        of_bright = float(np.median(np.abs(row[bright]))) ** 2
        of_dark = of_bright if bright.all() else float(np.median(np.abs(row[~bright]))) ** 2
        slope = max(of_bright - of_dark, 0.0) / (high - low) if high > low else 0.0
        variance = NORMAL_OVER_MEDIAN**2 * (of_dark + slope * (mean - low))
        limit[:] = _OUTLIER_SIGMAS**2 * np.maximum(variance, 1 / 12)
    return offset**2 <= limits


def _is_significant(sizes: NDArray[np.float64], variance: float, degrees: int) -> bool:
    """Whether one size per repeat varies by more than noise of that variance explains."""
    repeats = sizes.size
    statistic = float(np.sum((sizes - sizes.mean()) ** 2)) / (repeats - 1)
    if variance <= 0:
        return statistic > 0
    return bool(fisher_tail(statistic / variance, repeats - 1, degrees) < LIGHT_FALSE_ALARM)


def _sizes(
    deviation: NDArray[np.float64], model: NDArray[np.float64], mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(repeat,) factors of a model (n,) in deviations (repeat, n), and the rest.

    The rest is 0 for cosmic rays. The mean count of the pixels is (n,), DN.
    """
    sizes, usual = np.zeros(len(deviation)), np.ones(deviation.shape, bool)
    for _ in range(_ROUNDS):
        usual = _without_outliers(deviation - sizes[:, None] * model, mean)
        before, pairs = sizes, zip(deviation, usual, strict=True)
        sizes = np.array([row[use] @ model[use] / max(float(model[use] @ model[use]), 1e-300) for row, use in pairs])
        if np.array_equal(sizes, before):
            break
    return sizes, np.where(usual, deviation - sizes[:, None] * model, 0.0)


def light_change(counts: NDArray[np.float64], dark: NDArray[np.float64] | None, good: NDArray[np.bool_]) -> float:
    """Relative change of the light between repeats, as far as it is larger than noise.

    Parameters
    ----------
    counts
        (repeat, y, x) counts of two repeats or more, DN.
    dark
        (y, x) dark level at their exposure, DN, for a uniform field. None for a scene: the change then comes from its
        contrasts, so that an offset that varies is none.
    good
        (y, x) True for pixels used.

    Returns
    -------
    float
        Largest minus smallest light, over its mean. 0 where noise explains it, or without light: sound repeats differ
        by more with a probability of LIGHT_FALSE_ALARM.
    """
    mean = counts.mean(axis=0)
    if dark is None:
        steady = counts - (counts - mean)[:, good].mean(axis=1)[:, None, None] if good.any() else counts
        slopes = _slopes(steady - mean, mean, good)
        return 0.0 if slopes is None else float(np.ptp(slopes))
    level = float((mean - dark)[good].mean()) if good.any() else 0.0
    deviation = (counts - mean)[:, good]
    if level <= 0 or deviation.shape[1] < 2:
        return 0.0
    sizes, rest = _sizes(deviation, np.ones(deviation.shape[1]), mean[good])
    repeats, pixels = deviation.shape
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
    if not good.any():
        return None
    picture = mean[good] - mean[good].mean()
    rows = deviation[:, good]
    lever = float(np.sum(picture**2))
    repeats, pixels = rows.shape
    if lever <= 0 or pixels < 3:
        return None
    slopes, rest = _sizes(rows, picture, mean[good])
    slopes -= slopes.mean()
    degrees = (repeats - 1) * (pixels - 2)
    variance = float(np.sum(rest**2)) / degrees
    if np.ptp(slopes) < LIGHT_CHANGE_NOTED or not _is_significant(slopes, variance / lever, degrees):
        return None
    return slopes
