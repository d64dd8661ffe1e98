"""Noise of single pixels from the differences of neighbours in one picture.

The second difference x(i - s) - 2 x(i) + x(i + s) along a row or a column removes what varies linearly. For independent
pixels of variance v its variance is 6 v. Edges and texture make some differences larger; pixels near these are left
out.

Without flats the scatter of the pixels' sensitivities is a part of this noise, without darks that of their dark
levels. The first is estimated from the differences in the pictures, which shading and edges widen. Both are estimated
from those of the residuals of a comparison: the rendering takes shading and edges away. What the model lacks changes
gradually or at few edges, and stays visible.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.utils.distributions import normal_density, robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.optimize import nnls
from scipy.special import ndtr

__all__ = [
    "clipped_variance",
    "pixel_scatter",
    "scatter_of_residuals",
    "second_differences",
    "smooth_pixels",
    "steps_of_cells",
    "steps_within",
]

#: (rows, columns) from a pixel to its neighbour, px.
Step = tuple[int, int]
#: Variance of a second difference over that of one pixel: 1 + 4 + 1.
_GAIN = 6.0
#: Share of the middle pixel in it.
_MIDDLE_SHARE = 4.0 / _GAIN
#: Standard deviations beyond which a difference is an edge and no noise.
_CLIP = 3.0
#: Levels of light at which the scatter of the differences is taken.
_LEVELS = 12
#: Rounds by which edges are found: their neighbours then no longer widen the limit.
_EDGE_ROUNDS = 8
#: Rounds of clipping: the variance then changes by less than 0.1 %.
_ROUNDS = 20
#: Differences for each pixel of a channel at which no longer steps are added: rows and columns have nearly two.
_DIFFERENCES_A_PIXEL = 1.5
#: The same for residuals, from which a rendering takes the edges: the estimate of dark levels then scatters by a fifth
#: less, behind Bayer and X-Trans mosaics of 64 px.
_RESIDUALS_A_PIXEL = 4.0
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
    sigma = robust_sigma(values)
    for _ in range(_ROUNDS):
        inside = np.abs(values) <= _CLIP * sigma
        sigma = float(np.sqrt(np.mean(values[inside] ** 2) / truncated))
    return sigma**2


def _triples(picture: NDArray, step: Step) -> list[NDArray]:
    """Three copies of a picture (y, x), shifted by 0, 1 and 2 steps; empty if too small."""
    copies = []
    for number in range(3):
        part = picture
        for axis, size in enumerate(step):
            length = max(picture.shape[axis] - 2 * abs(size), 0)
            first = number * size if size >= 0 else (number - 2) * size
            part = np.take(part, np.arange(first, first + length), axis)
        copies.append(part)
    return copies


def steps_of_cells(cell: tuple[int, int] | None) -> tuple[Step, ...]:
    """Steps along rows and columns to the same place in the next repeat of a mosaic.

    Parameters
    ----------
    cell
        (rows, columns) of one repeat, px; None without a mosaic.

    Returns
    -------
    tuple
        (rows, columns) of each step.
    """
    rows, columns = cell or (1, 1)
    return (rows, 0), (0, columns)


def steps_within(
    usable: NDArray[np.bool_], cell: tuple[int, int], a_pixel: float = _DIFFERENCES_A_PIXEL
) -> tuple[Step, ...]:
    """Shortest steps between pixels of one channel, on which enough differences lie.

    Parameters
    ----------
    usable
        (y, x) True for pixels used, all of one channel.
    cell
        (rows, columns) of one repeat of the mosaic, px; (1, 1) without one.
    a_pixel
        Differences for each pixel at which no longer steps are added.

    Returns
    -------
    tuple
        (rows, columns) of each step: along rows and columns, and slanted where a mosaic has nearer neighbours so.
    """
    if cell == (1, 1):
        return steps_of_cells(cell)
    down, right = cell
    every = [(y, x) for y in range(down + 1) for x in range(-right, right + 1) if y > 0 or x > 0]
    steps: list[Step] = []
    missing = a_pixel * np.count_nonzero(usable)
    for step in sorted(every, key=lambda step: (step[0] ** 2 + step[1] ** 2, step)):
        count = np.count_nonzero(np.logical_and.reduce(_triples(usable, step)))
        if count:
            steps, missing = [*steps, step], missing - count
        if missing <= 0:
            break
    return tuple(steps)


def second_differences(
    picture: NDArray[np.float64], usable: NDArray[np.bool_], steps: Sequence[Step]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Second differences along steps, scaled to the variance of one pixel.

    Parameters
    ----------
    picture
        (y, x) values.
    usable
        (y, x) True for pixels used; a difference needs all its three.
    steps
        (rows, columns) from a pixel to its neighbours, px.

    Returns
    -------
    NDArray
        (n,) differences over the square root of 6.
    NDArray
        (n,) mean of the three pixels, each with its share of the difference's variance: of variances it is exact.
    """
    differences, means = [np.zeros(0)], [np.zeros(0)]
    for step in steps:
        first, middle, last = _triples(picture, step)
        used = np.logical_and.reduce(_triples(usable, step))
        differences.append(((first - 2 * middle + last) / np.sqrt(_GAIN))[used])
        means.append((_MIDDLE_SHARE * middle + (1 - _MIDDLE_SHARE) * (first + last) / 2)[used])
    return np.concatenate(differences), np.concatenate(means)


def smooth_pixels(picture: NDArray[np.float64], usable: NDArray[np.bool_], steps: Sequence[Step]) -> NDArray[np.bool_]:
    """Usable pixels away from edges and outliers.

    Parameters
    ----------
    picture
        (y, x) signal.
    usable
        (y, x) True for pixels used.
    steps
        (rows, columns) from a pixel to its neighbours, px.

    Returns
    -------
    NDArray
        (y, x) True where no second difference nearby exceeds three standard deviations of those at its level of light.
    """
    smooth = usable
    reach = np.ones([2 * max(abs(step[axis]) for step in steps) + 1 for axis in range(2)] if steps else (1, 1), bool)
    for _ in range(_EDGE_ROUNDS):
        level, sigma = _sigma_by_level(*second_differences(picture, smooth, steps))
        if not level.size:
            break
        edges = np.zeros(picture.shape, bool)
        for step in steps:
            first, middle, last = _triples(picture, step)
            expected = np.interp((first + middle + last) / 3, level, sigma)
            large = np.abs(first - 2 * middle + last) > _CLIP * np.sqrt(_GAIN) * expected
            large &= np.logical_and.reduce(_triples(usable, step))
            sides = zip(step, picture.shape, strict=True)
            inside = tuple(slice(abs(size), length - abs(size)) for size, length in sides)
            edges[inside] |= large
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
    cell: tuple[int, int] = (1, 1),
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
    cell
        (rows, columns) of one repeat of the mosaic, px; (1, 1) without one.

    Returns
    -------
    float
        Standard deviation, 0 where temporal noise explains the scatter; NaN with too few pixels.
    """
    if not usable.any():
        return float("nan")
    bright = usable & (signal >= max(float(np.median(signal[usable])), 0.0)) & (signal > 0)
    steps = steps_within(bright, cell)
    smooth = smooth_pixels(signal, bright, steps)
    differences, means = second_differences(signal, smooth, steps)
    if differences.size < _FEWEST:
        return float("nan")
    _, temporal = second_differences(variance, smooth, steps)
    relative = clipped_variance(differences / means) - float(np.median(temporal / means**2))
    return float(np.sqrt(max(relative, 0.0)))


def scatter_of_residuals(
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    variance: NDArray[np.float64],
    usable: NDArray[np.bool_],
    shapes: Sequence[NDArray[np.float64]],
    cell: tuple[int, int] = (1, 1),
) -> NDArray[np.float64]:
    """Scatter of the pixels in the residuals of a comparison.

    The variance of a difference is that of its noise and of what scatters from pixel to pixel. The sizes that make the
    differences most probable count, without differences beyond three standard deviations.

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
    shapes
        (band, y, x) each, change of the signal by one unit of what scatters, DN: the signal for sensitivities.
    cell
        (rows, columns) of one repeat of the mosaic, px; (1, 1) without one.

    Returns
    -------
    NDArray
        (shape,) standard deviations in the units of the shapes, 0 where the others explain the differences; NaN with
        too few pixels.
    """
    positive = usable & (rendered > 0)
    unit = np.where(positive, rendered, 1.0)
    differences, noises, parts = [], [], []
    for band, used in enumerate(positive):
        steps = steps_within(used, cell, _RESIDUALS_A_PIXEL)
        curvature, level = second_differences(rendered[band], used, steps)
        inside = np.abs(curvature) < _EDGE * level
        differences.append(second_differences(measured[band] / unit[band], used, steps)[0][inside])
        noises.append(second_differences(variance[band] / unit[band] ** 2, used, steps)[1][inside])
        squares = [(shape[band] / unit[band]) ** 2 for shape in shapes]
        parts.append(np.array([second_differences(square, used, steps)[1][inside] for square in squares]))
    difference, of_noise, of_shapes = np.concatenate(differences), np.concatenate(noises), np.concatenate(parts, axis=1)
    if difference.size < _FEWEST:
        return np.full(len(shapes), np.nan)
    square, truncated = difference**2, _truncated_variance(_CLIP)
    sizes = np.full(len(shapes), clipped_variance(difference / np.sqrt(of_shapes.sum(axis=0))))
    for _ in range(_SCATTER_ROUNDS):
        total = of_noise + sizes @ of_shapes
        weight = (square <= _CLIP**2 * total) / total
        sizes = nnls((weight * of_shapes).T, weight * (square / truncated - of_noise))[0]
    return np.sqrt(sizes)
