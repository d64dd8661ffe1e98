"""Noise of single pixels from the differences of neighbours in one picture.

The second difference x(i - s) - 2 x(i) + x(i + s) along a row or a column removes what varies linearly. For independent
pixels of variance v its variance is 6 v. Edges and texture make some differences larger; pixels near these are left
out.

Without flats the scatter of the pixels' sensitivities is a part of this noise. It is estimated from the differences in
the pictures, which shading and edges widen, and again from those of the residuals of a comparison. The rendering takes
shading and edges away. What the model lacks changes gradually or at few edges, and stays visible.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import normal_density
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.special import ndtr

__all__ = ["clipped_variance", "pixel_scatter", "scatter_of_residuals", "second_differences", "smooth_pixels"]

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
_FEWEST = 200
#: Second difference of the rendering, relative and scaled to one pixel's variance, from which on three pixels lie
#: across an edge. One rendered a tenth of a pixel aside changes them by as much as usual sensitivities scatter.
_EDGE = 0.1
#: Rounds by which the scatter is fitted: each one reduces its error by a factor of 10 at least.
_SCATTER_ROUNDS = 30


def _truncated_variance(clip: float) -> float:
    """Variance of a normal distribution of variance 1 that is cut off at ``clip`` on both sides."""
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
    if values.size < _FEWEST:
        return float("nan")
    truncated = _truncated_variance(_CLIP)
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
        if np.count_nonzero(remaining) < _FEWEST:
            break
        smooth = remaining
    return smooth


def _sigma_by_level(
    differences: NDArray[np.float64], means: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ascending levels of light and standard deviations at each; empty for too few pixels."""
    groups = np.array_split(np.argsort(means), max(1, min(_LEVELS, means.size // _FEWEST)))
    variances = np.array([clipped_variance(differences[group]) for group in groups])
    levels = np.array([means[group].mean() if group.size else np.nan for group in groups])
    finite = np.isfinite(variances) & np.isfinite(levels)
    return levels[finite], np.sqrt(variances[finite])


def pixel_scatter(
    signal: NDArray[np.float64],
    variance: NDArray[np.float64],
    usable: NDArray[np.bool_],
    step: tuple[int, int] = (1, 1),
) -> float:
    """Relative scatter of the pixels' sensitivities in the bright half of a picture.

    Parameters
    ----------
    signal
        (y, x) signal above dark, DN.
    variance
        (y, x) variance of its temporal noise, DN^2.
    usable
        (y, x) True for pixels used.
    step
        (rows, columns) distance of neighbours with the same filter, px.

    Returns
    -------
    float
        Standard deviation, 0 where temporal noise explains the scatter; NaN with too few pixels.
    """
    if not usable.any():
        return float("nan")
    bright = usable & (signal >= max(float(np.median(signal[usable])), 0.0)) & (signal > 0)
    smooth = smooth_pixels(signal, bright, step)
    differences, means = second_differences(signal, smooth, step)
    if differences.size < _FEWEST:
        return float("nan")
    _, temporal = second_differences(variance, smooth, step)
    relative = clipped_variance(differences / means) - float(np.median(temporal / means**2))
    return float(np.sqrt(max(relative, 0.0)))


def scatter_of_residuals(
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    variance: NDArray[np.float64],
    usable: NDArray[np.bool_],
    step: tuple[int, int] = (1, 1),
) -> float:
    """Relative scatter of the pixels' sensitivities in the residuals of a comparison.

    The variance of a difference is that of its noise and of the scatter. The scatter that makes the differences most
    probable counts, without those beyond three standard deviations.

    Parameters
    ----------
    measured
        (band, y, x) measured signals, DN.
    rendered
        (band, y, x) rendered signals, DN.
    variance
        (band, y, x) variance of measured minus rendered, without the scatter, DN^2.
    usable
        (band, y, x) True for pixels used; those without rendered light are left out.
    step
        (rows, columns) distance of neighbours with the same filter, px.

    Returns
    -------
    float
        Standard deviation, 0 where noise explains the differences; NaN with too few pixels.
    """
    positive = usable & (rendered > 0)
    unit = np.where(positive, rendered, 1.0)
    differences, noises = [], []
    for band, used in enumerate(positive):
        curvature, level = second_differences(rendered[band], used, step)
        inside = np.abs(curvature) < _EDGE * level
        differences.append(second_differences(measured[band] / unit[band], used, step)[0][inside])
        noises.append(second_differences(variance[band] / unit[band] ** 2, used, step)[1][inside])
    difference, of_noise = np.concatenate(differences), np.concatenate(noises)
    if difference.size < _FEWEST:
        return float("nan")
    square, truncated = difference**2, _truncated_variance(_CLIP)
    scatter = clipped_variance(difference)
    for _ in range(_SCATTER_ROUNDS):
        total = of_noise + scatter
        weight = (square <= _CLIP**2 * total) / total**2
        scatter = max(float(np.sum(weight * (square / truncated - of_noise)) / np.sum(weight)), 0.0)
    return float(np.sqrt(scatter))
