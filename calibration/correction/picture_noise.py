"""Noise of single pixels from the differences of neighbours in one picture.

The second difference x(i - s) - 2 x(i) + x(i + s) along a row or a column removes what varies linearly. For independent
pixels of variance v its variance is 6 v. Edges and texture make some differences larger; pixels near these are left
out.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import normal_density
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.special import ndtr

__all__ = ["FEWEST", "clipped_variance", "second_differences", "smooth_pixels", "truncated_variance"]

#: Variance of a second difference over that of one pixel: 1 + 4 + 1.
_GAIN = 6.0
#: Standard deviations beyond which a difference is an edge and no noise.
_CLIP = 3.0
#: Levels of light at which the scatter of the differences is taken.
_LEVELS = 12
#: Rounds by which edges are found: their neighbours then no longer widen the limit.
_EDGE_ROUNDS = 8
#: Rounds of clipping: the variance then changes by less than 0.1 %.
_ROUNDS = 20
#: Standard deviation of a normal distribution over its median absolute deviation.
_MAD_TO_SIGMA = 1.4826
#: Fewest differences from which a variance is taken: its relative error is then a tenth.
FEWEST = 200


def truncated_variance(clip: float) -> float:
    """Variance of a normal distribution of variance 1 that is cut off on both sides.

    Parameters
    ----------
    clip
        Where it is cut off, standard deviations.

    Returns
    -------
    float
        Below 1.
    """
    return float(1 - 2 * clip * normal_density(clip) / (ndtr(clip) - ndtr(-clip)))


def clipped_variance(values: NDArray[np.float64]) -> float:
    """Variance of the normal part of values about 0, without those far out.

    Parameters
    ----------
    values
        (n,) values, most of them normal with mean 0.

    Returns
    -------
    float
        Variance; NaN for less than 200 values.
    """
    if values.size < FEWEST:
        return float("nan")
    truncated = truncated_variance(_CLIP)
    sigma = _MAD_TO_SIGMA * float(np.median(np.abs(values)))
    for _ in range(_ROUNDS):
        inside = np.abs(values) <= _CLIP * sigma
        sigma = float(np.sqrt(np.mean(values[inside] ** 2) / truncated))
    return sigma**2


def _triples(picture: NDArray, axis: int, size: int) -> list[NDArray]:
    """Three copies of a picture (y, x), shifted by 0, 1 and 2 steps along an axis."""
    ends = max(picture.shape[axis] - 2 * size, 0)
    return [np.take(picture, np.arange(k, k + ends), axis) for k in (0, size, 2 * size)]


def second_differences(
    picture: NDArray[np.float64], usable: NDArray[np.bool_], step: tuple[int, int] = (1, 1)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Second differences along rows and columns, scaled to the variance of one pixel.

    Parameters
    ----------
    picture
        (y, x) values.
    usable
        (y, x) True for pixels used; a difference needs all its three.
    step
        (rows, columns) distance of the neighbours, px: the repeat of a mosaic.

    Returns
    -------
    NDArray
        (n,) differences over the square root of 6.
    NDArray
        (n,) mean of the three pixels.
    """
    differences, means = [], []
    for axis, size in enumerate(step):
        first, middle, last = _triples(picture, axis, size)
        used = np.logical_and.reduce(_triples(usable, axis, size))
        differences.append(((first - 2 * middle + last) / np.sqrt(_GAIN))[used])
        means.append(((first + middle + last) / 3)[used])
    return np.concatenate(differences), np.concatenate(means)


def smooth_pixels(
    picture: NDArray[np.float64], usable: NDArray[np.bool_], step: tuple[int, int] = (1, 1)
) -> NDArray[np.bool_]:
    """Usable pixels away from edges and outliers.

    Parameters
    ----------
    picture
        (y, x) signal.
    usable
        (y, x) True for pixels used.
    step
        (rows, columns) distance of the neighbours, px: the repeat of a mosaic.

    Returns
    -------
    NDArray
        (y, x) True where no second difference nearby exceeds three standard deviations of those at its level of light.
    """
    smooth = usable
    reach = np.ones([2 * size + 1 for size in step], bool)
    for _ in range(_EDGE_ROUNDS):
        level, sigma = _sigma_by_level(*second_differences(picture, smooth, step))
        if not level.size:
            break
        edges = np.zeros(picture.shape, bool)
        for axis, size in enumerate(step):
            first, middle, last = _triples(picture, axis, size)
            expected = np.interp((first + middle + last) / 3, level, sigma)
            large = np.abs(first - 2 * middle + last) > _CLIP * np.sqrt(_GAIN) * expected
            large &= np.logical_and.reduce(_triples(usable, axis, size))
            inside = [slice(None), slice(None)]
            inside[axis] = slice(size, picture.shape[axis] - size)
            edges[tuple(inside)] |= large
        remaining = usable & ~binary_dilation(edges, reach)
        if np.count_nonzero(remaining) < FEWEST:
            break
        smooth = remaining
    return smooth


def _sigma_by_level(
    differences: NDArray[np.float64], means: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ascending levels of light and standard deviations at each; empty for too few pixels."""
    groups = np.array_split(np.argsort(means), max(1, min(_LEVELS, means.size // FEWEST)))
    variances = np.array([clipped_variance(differences[group]) for group in groups])
    levels = np.array([means[group].mean() if group.size else np.nan for group in groups])
    finite = np.isfinite(variances) & np.isfinite(levels)
    return levels[finite], np.sqrt(variances[finite])
