"""Correlation of noise between pixels, from the scatter of blocks and of second differences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.ndimage import mean as mean_of

__all__ = ["clustering_by_filter", "clustering_of_blocks", "clustering_of_neighbours", "difference_variance"]

#: Pixels a side of the blocks whose means show the correlation between pixels: four, larger than a pixel filter.
_BLOCK_PX = 4
#: Part of a block that is smooth at least, where few blocks are so all over.
_LEAST_PART = 0.5
#: Standard errors by which such blocks must scatter more than independent pixels.
_SIGNIFICANT = 3.0
#: Blocks along a side below which clustering is not estimated.
_MIN_BLOCKS = 4
#: Part by which second differences of neighbours are smaller than those of pixels two apart in correlated noise.
_LEAST_SMOOTHNESS = 0.1
#: The same part in its own standard deviations, for small pictures.
_SMOOTHNESS_SIGMAS = 4.0
#: Correlation between pixels at a distance below which noise reaches no further.
_LITTLE_CORRELATION = 0.05
#: Growth of second differences from a distance to twice as far, below which noise reaches no further.
_NO_GROWTH = 1.35
#: Square of second differences of independent numbers over their variance: 1 + 4 + 1.
_SECOND_DIFFERENCE = 6.0
#: Distances in px at which noise of a pixel filter may end.
_FILTER_PX = (1, 2, 3)
#: Largest part of the correlation that the means of small regions remove and that is made up for.
_MOST_REMOVED = 0.5
#: Squares count at most this many times their median in a mean: 30 cuts outliers and leaves normal noise alone.
_SQUARE_CUT = 30
#: Fewest pairs of neighbours whose mean square is used.
_MIN_PAIRS = 20


def clustering_of_blocks(
    values: NDArray[np.float64], smooth: NDArray[np.bool_], *, curved: bool = False, partly: bool = False
) -> float:
    """Scatter of block means over that of independent pixels; 1 where there are few.

    Parameters
    ----------
    values
        (y, x) differences, clipped, in units of their scatter.
    smooth
        (y, x) pixels away from edges.
    curved
        Whether second differences of blocks count, which a gradient does not change.
    partly
        Whether half smooth blocks count where few are smooth all over. A change of the picture scatters them, too.

    Returns
    -------
    float
        The ratio.
    """
    height, width = (size // _BLOCK_PX * _BLOCK_PX for size in values.shape)
    if height < _MIN_BLOCKS * _BLOCK_PX or width < _MIN_BLOCKS * _BLOCK_PX:
        return 1.0
    shape = height // _BLOCK_PX, _BLOCK_PX, width // _BLOCK_PX, _BLOCK_PX
    mask = smooth[:height, :width].reshape(shape)
    pixels = mask.sum(axis=(1, 3))
    sums = np.where(mask, values[:height, :width].reshape(shape), 0.0).sum(axis=(1, 3)) / np.sqrt(np.maximum(pixels, 1))
    single = max(difference_variance(values, smooth), 1e-12)
    for part in (1.0, _LEAST_PART) if partly else (1.0,):
        inside = pixels >= part * _BLOCK_PX**2
        scatter = _curvature(sums, inside) if curved else difference_variance(sums, inside)
        if np.isfinite(scatter):
            ratio = scatter / single
            # neighbours share a block: their differences are worth two thirds of the blocks
            by_chance = 1 + _SIGNIFICANT * np.sqrt(3 / inside.sum())
            return ratio if part == 1.0 or ratio > by_chance else 1.0
    return 1.0


def _curvature(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> float:
    """Variance by second differences of neighbours; NaN for few of them."""
    square, count = _second_differences(values, inside, 1)
    return square / _SECOND_DIFFERENCE if count >= _MIN_PAIRS else float("nan")


def clustering_by_filter(values: NDArray[np.float64], smooth: NDArray[np.bool_]) -> float | None:
    """Sum of the correlation between pixels of filtered noise; None for other differences.

    Second differences of filtered noise stop growing at some distance. A smooth difference of the pictures makes them
    grow later, and adds nothing here. Their size at one pixel gives the width of a Gaussian filter.

    Parameters
    ----------
    values
        (y, x) differences, clipped, in units of their scatter.
    smooth
        (y, x) pixels away from edges.

    Returns
    -------
    float or None
        The sum, at least 1.
    """
    sizes = {}
    for step in (1, *_FILTER_PX, *(2 * px for px in _FILTER_PX)):
        sizes[step], pixels = _second_differences(values, smooth, step)
        if pixels < _MIN_PAIRS:
            return None
    reach = next((px for px in _FILTER_PX if sizes[2 * px] <= _NO_GROWTH * sizes[px]), None)
    if reach is None:
        return None
    part = sizes[1] / max(sizes[reach], sizes[2 * reach], 1e-300)
    if part >= 1:
        return 1.0
    # second differences over 6 variances are 1 - (4 c - c^4) / 3 for a correlation c of neighbours
    grid = np.linspace(0.0, 1.0, 1001)[1:-1]
    correlation = float(np.interp(3 * (1 - part), 4 * grid - grid**4, grid))
    lags = np.arange(-4 * reach, 4 * reach + 1)
    return float((correlation ** (lags**2)).sum() ** 2)


def clustering_of_neighbours(values: NDArray[np.float64], smooth: NDArray[np.bool_]) -> float:
    """Sum of the correlation between pixels over all distances; 1 without one.

    Noise of a wide filter or a denoiser has smaller second differences of neighbours than of pixels two apart. A smooth
    difference of the pictures on top of independent noise has not.

    Parameters
    ----------
    values
        (y, x) differences, clipped, in units of their scatter.
    smooth
        (y, x) pixels away from edges.

    Returns
    -------
    float
        The sum.
    """
    (near, pixels), (far, _) = (_second_differences(values, smooth, step) for step in (1, 2))
    if pixels < _MIN_PAIRS or not near < far * (1 - max(_LEAST_SMOOTHNESS, _SMOOTHNESS_SIGMAS * np.sqrt(3 / pixels))):
        return 1.0
    regions, count = label(smooth)
    index = np.arange(1, count + 1)
    means = np.r_[0.0, mean_of(values, regions, index)]
    mask = smooth.astype(float)
    centred = mask * (values - means[regions])
    shape = 2 * values.shape[0], 2 * values.shape[1]
    product, pairs = (np.fft.irfft2(np.abs(np.fft.rfft2(p, shape)) ** 2, shape) for p in (centred, mask))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.where(pairs > 0.5, product / pairs, 0.0)
    correlation /= max(float(correlation[0, 0]), 1e-300)
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    distance = np.hypot(down[:, None], right[None])
    reach = min(values.shape) // 4
    for radius in range(1, reach + 1):
        ring = (distance >= radius - 0.5) & (distance < radius + 0.5)
        if float(correlation[ring].mean()) < _LITTLE_CORRELATION:
            reach = radius
            break
    near_enough = distance < reach + 0.5
    # the regions' means, which are removed, take this part of the sum with them
    sizes = np.bincount(regions[smooth])
    removed = float(near_enough.sum()) * smooth.sum() / float((sizes**2).sum())
    return float(correlation[near_enough].sum()) / (1 - min(removed, _MOST_REMOVED))


def _second_differences(values: NDArray[np.float64], inside: NDArray[np.bool_], step: int) -> tuple[float, int]:
    """Mean square of second differences of pixels some steps apart, and their count."""
    differences = []
    for picture, mask in ((values, inside), (values.T, inside.T)):
        middle, before, after = np.s_[step:-step], np.s_[: -2 * step], np.s_[2 * step :]
        used = mask[middle] & mask[before] & mask[after]
        differences.append((picture[before] - 2 * picture[middle] + picture[after])[used])
    squares = np.concatenate(differences) ** 2
    if not squares.size:
        return float("nan"), 0
    return float(np.minimum(squares, _SQUARE_CUT * np.median(squares)).mean()), int(squares.size)


def difference_variance(values: NDArray, inside: NDArray[np.bool_]) -> float:
    """Half the mean square of differences between neighbours; NaN for few pairs.

    Parameters
    ----------
    values
        (y, x) differences, clipped, in units of their scatter.
    inside
        (y, x) pixels away from edges.

    Returns
    -------
    float
        The variance of independent pixels.
    """
    differences = []
    for axis in (0, 1):
        pairs = np.diff(values, axis=axis)
        both = np.logical_and(
            np.take(inside, range(1, inside.shape[axis]), axis),
            np.take(inside, range(inside.shape[axis] - 1), axis),
        )
        differences.append(pairs[both])
    squares = np.concatenate(differences) ** 2
    if squares.size < _MIN_PAIRS:
        return float("nan")
    return 0.5 * float(np.minimum(squares, _SQUARE_CUT * np.median(squares)).mean())
