"""Slow changes over the picture: gradients, vignettes, a quarter of another brightness.

Means of small blocks know little of them, and noise that a filter or a denoiser spreads over pixels hides them there.
Polynomials of the second order over the picture collect the difference instead. Their power is compared with that of
waves of two to sixteen half periods, so that no variance has to be known. Noise of a wide denoiser grows towards slow
waves. Its growth among the waves is taken to continue. Independent noise does not grow, and small blocks are then
independent. The scatter of a polynomial's parts from block to block is the test.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from cboxlab.utils.distributions import fisher_tail
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .difference import Difference, Finding, common_size, sigma_of

__all__ = ["slow_change", "without_slow"]

#: Name of the finding.
_NAME = "slow change over the picture"
#: Cells along the longer side of the picture, in which pixels are summed: three for each half period.
_CELLS = 48
#: Half periods of the slowest wave for comparison: slower ones share a part with the polynomials.
_SLOWEST = 2.2
#: Half periods up to which waves lie next to the polynomials.
_NEXT = 4.0
#: Half periods up to which waves show the growth of noise towards slow ones.
_GROWN = 5.0
#: Half periods up to which waves give the level of the noise.
_LEVEL = 8.0
#: Blocks along each side of the picture, between which noise is independent.
_BLOCKS = 8
#: The same for noise that is not correlated between pixels.
_SMALL_BLOCKS = 16
#: Fewest pixels a side of such a block.
_LEAST_BLOCK_PX = 4
#: Half periods of the fastest wave.
_FASTEST = 16.0
#: Scatters at which single pixels are cut, after a common factor: a firefly has power at all frequencies.
_CUT = 5.0
#: Pixels a side of the window that gives the local level.
_LEVEL_PX = 5
#: Least light of a pixel over the median one: filters spread the noise of bright parts over dark ones.
_LEAST_LEVEL = 0.1
#: Light of a pixel over the local level, above which it counts less: the lamp's edge would rule the picture.
_MOST_LIGHT = 2.0
#: Pixels a side of the window that gives the local scatter.
_WINDOW_PX = 7
#: Pixels a side of the smallest picture.
_LEAST_PX = 24
#: Part of the picture that is tested at least.
_LEAST_PART = 0.3


def slow_change(difference: Difference) -> Finding | None:
    """Clearest polynomial of the second order over the picture.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the polynomial's root mean square. None for a small picture, or one of few pixels with light.
    """
    used = np.logical_or(difference.smooth, difference.groups.get("edges", difference.smooth))
    if min(used.shape) < _LEAST_PX or float(used.mean()) < _LEAST_PART:
        return None
    first = _cells(difference, used, 0 * difference.level)
    if first is None:
        return None
    # the scatter is that about a first fit, or a slow change would hide itself
    rough = _fitted(*first)
    cells = _cells(difference, used, np.tensordot(rough, _polynomials(*_middles(used.shape)), 1))
    if cells is None:
        return None
    goal, weight = cells
    polynomials = _polynomials(*_middles(goal.shape))
    waves, halves = _waves(goal.shape)
    bright = weight > 0
    if bright.sum() < 2 * (len(polynomials) + len(waves)):
        return None
    shapes = np.stack([shape[bright] * weight[bright] for shape in (*polynomials, *waves)], axis=1)
    # the last column of the triangle holds the products of the goal with the orthogonal shapes
    triangle = np.asarray(np.linalg.qr(np.column_stack([shapes, goal[bright]]), mode="r"))
    power = triangle[:-1, -1] ** 2
    free = len(polynomials) - 1
    slow = float(power[1 : free + 1].mean())
    shapes = np.linalg.qr(shapes[:, : free + 1])[0][:, 1:]
    sizes = shapes.T @ goal[bright]
    rest = goal[bright] - shapes @ sizes
    terms, norms = shapes * (rest[:, None] + shapes * sizes), shapes**2
    if difference.of_pixel_filter and difference.clustering == 1:
        shortest = min(used.shape)
        numbers = {min(_SMALL_BLOCKS, shortest // _LEAST_BLOCK_PX), _BLOCKS}
        probability = max(
            _by_blocks(terms, norms, bright, n, 1 + difference.clustering * (n / shortest) ** 2) for n in numbers
        )
    else:
        alike = 1 + difference.clustering * (_BLOCKS / min(used.shape)) ** 2
        by_blocks = _by_blocks(terms, norms, bright, _BLOCKS, alike)
        probability = max(_by_waves(slow, free, power[free + 1 :], halves), by_blocks)
    size = float(np.sqrt(slow * free / max(float((weight**2).sum()), 1e-300)))
    sigma = sigma_of(size, probability, len(waves))
    amplitudes = {"amplitudes": rough}
    return Finding(_NAME, int(used.sum()), size, sigma, len(waves), probability, amplitudes)


def without_slow(difference: NDArray[np.float64], level: NDArray[np.float64], finding: Finding) -> NDArray[np.float64]:
    """Difference without a slow change.

    Parameters
    ----------
    difference, level
        (y, x, w) difference, and radiance of the baseline.
    finding
        Outcome of ``slow_change`` for their sums over wavelengths.

    Returns
    -------
    NDArray
        (y, x, w) difference.
    """
    relative = np.tensordot(finding.parameters["amplitudes"], _polynomials(*_middles(level.shape[:2])), 1)
    return difference - relative[..., None] * np.maximum(level + 0.5 * difference, 0.0)


def _middles(shape: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """(v, u) coordinates of cells, downwards and to the right, from -1 to 1."""
    return list(np.meshgrid(*(np.linspace(-1, 1, size) for size in shape), indexing="ij"))


def _polynomials(down: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6, v, u) polynomials of the second order, the constant one first."""
    return np.stack([np.ones_like(down), right, down, right * down, right**2, down**2])


def _fitted(goal: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) amplitudes of the polynomials."""
    bright = weight > 0
    shapes = np.stack([shape[bright] * weight[bright] for shape in _polynomials(*_middles(goal.shape))], axis=1)
    return np.asarray(np.linalg.lstsq(shapes, goal[bright], rcond=None)[0])


def _cells(
    difference: Difference, used: NDArray[np.bool_], about: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """(v, u) relative difference of cells over its scatter, and one over that scatter.

    about : (y, x) first fit of the relative difference, about which it scatters. None without noise.
    """
    half = np.maximum(difference.level + 0.5 * difference.total, 0.0)
    local = median_filter(half, _LEVEL_PX, mode="nearest")
    local = np.maximum(local, _LEAST_LEVEL * float(np.median(half[used])) + 1e-300)
    common = float(np.median((difference.total / local)[used]))
    most = _MOST_LIGHT * local
    share = np.divide(most, half, out=np.ones_like(half), where=half > most)
    half, total = share * half, share * difference.total
    rest = total - (common + about) * half
    around = 1.4826 * median_filter(np.where(used, np.abs(rest) / local, 0.0), _WINDOW_PX, mode="nearest")
    typical = float(np.median(around[used]))
    if typical <= 0:
        return None
    scatter = np.maximum(around, typical) * local
    values = np.where(used, about * half / scatter + np.clip(rest / scatter, -_CUT, _CUT), 0.0)
    light = np.where(used, half / scatter, 0.0)
    every = -(-max(used.shape) // _CELLS)
    products, squares = (_summed(picture, every) for picture in (values * light, light**2))
    weight = np.sqrt(squares)
    return np.divide(products, weight, out=np.zeros_like(products), where=weight > 0), weight


def _summed(picture: NDArray[np.float64], every: int) -> NDArray[np.float64]:
    """(v, u) sums over square cells; the last ones may be smaller."""
    rows, columns = (np.arange(0, size, every) for size in picture.shape)
    return np.asarray(np.add.reduceat(np.add.reduceat(picture, rows, axis=0), columns, axis=1))


@lru_cache(maxsize=8)
def _waves(shape: tuple[int, ...]) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    """Cosines (v, u) over the picture, and their half periods along the longer side."""
    height, width = shape
    longest = max(shape)
    rows, columns = ((np.arange(size) + 0.5) / size for size in shape)
    waves = []
    for down in range(int(_FASTEST * height / longest) + 1):
        for right in range(int(_FASTEST * width / longest) + 1):
            halves = float(np.hypot(down * longest / height, right * longest / width))
            if _SLOWEST <= halves <= _FASTEST:
                waves.append((halves, np.outer(np.cos(np.pi * down * rows), np.cos(np.pi * right * columns))))
    waves.sort(key=lambda wave: wave[0])
    return [wave for _, wave in waves], np.array([halves for halves, _ in waves])


def _by_waves(slow: float, free: int, power: NDArray[np.float64], halves: NDArray[np.float64]) -> float:
    """Probability of a slow power this large, by the waves next to it, and by more.

    The few next to it are asked for less, since they alone cannot make it small.
    """
    growth = max(1.0, float(power[halves <= _GROWN].mean()) / max(float(power[halves > _GROWN].mean()), 1e-300))
    around, near = power[halves <= _LEVEL], power[halves <= _NEXT]
    level = float(fisher_tail(slow / max(float(around.mean()) * growth, 1e-300), free, around.size))
    next_to_it = float(fisher_tail(slow / max(float(near.mean()) * np.sqrt(growth), 1e-300), free, near.size))
    return max(level, next_to_it**2)


def _by_blocks(
    terms: NDArray[np.float64],
    norms: NDArray[np.float64],
    bright: NDArray[np.bool_],
    blocks: int,
    alike: float = 1.0,
) -> float:
    """Probability of the clearest polynomial, by the scatter of its parts from block to block.

    terms, norms : (n, k) parts of the cells, and those of a size of 1. blocks : along each side of the picture.
    alike : number of neighbouring blocks that correlation makes one.
    """
    rows, columns = (np.arange(size) * blocks // size for size in bright.shape)
    block = (rows[:, None] * blocks + columns)[bright]
    parts = [[np.asarray(np.bincount(block, p, blocks**2), float) for p in columns_.T] for columns_ in (terms, norms)]
    return min(1.0, len(parts[0]) * min(common_size(t, n, alike)[3] for t, n in zip(*parts, strict=True)))
