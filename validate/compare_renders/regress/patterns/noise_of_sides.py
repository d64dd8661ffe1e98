"""Noise of one side alone: repeated, shared by a block of pixels, or made alike by a filter.

A renderer that starts each tile with the same random numbers repeats its noise from tile to tile. One that gives a
block of pixels the same numbers makes neighbours alike, but for those with a border of blocks between them. A wider
pixel filter makes all neighbours alike. Each changes products of a side with itself, moved. The products of one side
less those of the other are products of the difference with the sum. Structure of the scene cancels in the first. Where
it is strong in the second, a pixel counts less. Exchanged sides change the sign of the comparison alone, so that no
noise has to be known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.distributions import student_tail
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter

from .difference import Difference, Finding, self_normalised, sigma_of
from .fine_light import BLOCK_PX, block_sums

__all__ = ["filtered_noise", "reused_numbers", "shared_numbers"]

#: Pixels a side of the window whose mean is subtracted: noise of single pixels remains.
_WINDOW_PX = 3
#: Sum of the squared correlations of independent noise less its means over that window: 1 + 0.218 / 0.889^2.
_FINE_ALIKE = 1.28
#: Pixels a side of the window that gives the scatter of the difference around a pixel.
_SCALE_PX = 7
#: Steps along the line of a step whose median is subtracted, so that straight edges and gradients leave nothing.
_LINE_PX = 7
#: Least distance at which noise may repeat, px: filters and denoisers correlate nearer pixels.
_LEAST_PX = 6
#: Distances that are compared, from the clearest on.
_CANDIDATES = 4
#: Scatter over the largest fine difference below which it is rounding of a filter's sums, as where nothing has noise.
_ROUNDING = 1e-12
#: Scatters at which fine differences are cut.
_CUT = 4.0
#: Scatters at which a sum is cut: far more than counts, and its square is a number.
_LARGE = 1e6
#: Scatters of a sum from which it is structure of the scene, and counts less the larger it is.
_STRUCTURE = 4.0
#: The same where blocks of structure count less, too.
_STRUCTURE_OF_BLOCKS = 8.0
#: Median of the absolute value of a normal number.
_MEDIAN = 0.6745
#: Part of the picture that two pictures, moved, have in common at least.
_COMMON = 0.3
#: Comparison of the sides over the products of the difference, from which one side alone repeats.
_CLEARLY = 0.5
#: Probability, all distances counted, below which the side that repeats less repeats, too.
_REPEATS = 1e-2
#: Pixels a side of the smallest picture.
_LEAST_SIZE_PX = 24
#: Pixels a side of the blocks whose pixels may share random numbers: tiles and pixel groups of renderers.
_SHARED_PX = (2, 3, 4, 5, 6, 8)
#: Pixels a side of the windows whose means are subtracted before neighbours are compared: noise of two filters' widths.
_FILTER_PX = (5, 9)
#: Square of the sum over that of the difference in a block, from which it is structure of the scene.
_NOISY = 1.5
#: Sum of the correlations to the right and down, from which noise is filtered.
_LEAST_CORRELATION = 0.1


@dataclass(frozen=True, eq=False)
class _Sides:
    """Fine structure of both sides (y, x), over the local scatter of their difference."""

    #: Candidate less baseline.
    apart: NDArray[np.float64]
    #: Sum of both, less where it is structure of the scene.
    both: NDArray[np.float64]
    #: ``apart`` with the weights of ``both``.
    apart_alike: NDArray[np.float64]


def reused_numbers(difference: Difference) -> Finding | None:
    """Clearest distance at which the noise of one side repeats.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the part of the noise that repeats. None for small pictures, or where both sides repeat.
    """
    pictures = _apart_and_both(difference)
    if pictures is None:
        return None
    sides = _fine(pictures, _WINDOW_PX)
    height, width = sides.apart.shape
    repeated, of_difference = _products(sides.apart, sides.both), _products(sides.apart, sides.apart_alike)
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) for n in repeated.shape)
    overlap = (1 - down[:, None] / height) * (1 - right[None] / width)
    tested = (np.hypot(down[:, None], right[None]) >= _LEAST_PX) & (overlap >= _COMMON)
    tested[:, repeated.shape[1] // 2 :] = False  # each distance once
    tested[repeated.shape[0] // 2 :, 0] = False
    others = sides.both, sides.apart_alike
    edges = range(_LEAST_PX, min(height, width) // 2 + 1)
    tiles = {px: [_of_tiles(sides.apart, other, px) for other in others] for px in edges}
    # a filter that depends on the picture correlates products further than its noise: tiles of most sizes show how far
    squares = [float(terms.sum()) ** 2 / max(variance, 1e-300) for (terms, variance), _ in tiles.values()]
    neighbours_of_tiles = max(_FINE_ALIKE, difference.clustering / 2, float(np.median(squares)) / _MEDIAN**2)
    repeats: dict[str, tuple[int, int] | int] = {f"in tiles of {px} px": px for px in tiles}
    for products in (repeated, of_difference):
        clear = np.where(tested, np.abs(products) / np.sqrt(np.maximum(overlap, _COMMON)), 0.0)
        for index in np.argsort(clear, axis=None)[: -_CANDIDATES - 1 : -1]:
            row, column = (int(i) for i in np.unravel_index(int(index), clear.shape))
            row -= 0 if row < repeated.shape[0] // 2 else repeated.shape[0]
            repeats[f"{column} px right, {row} px down"] = (row, column)
    variances = [float(np.sum(sides.apart * (sides.apart_alike + sign * sides.both))) for sign in (-1, 1)]
    looks, findings = int(tested.sum()) + len(tiles), []
    for where, by in repeats.items():
        if isinstance(by, int):
            (terms, variance), (alike, _) = tiles[by]
            pairs, neighbours = (height // by) * (width // by) - 1, neighbours_of_tiles
            sigmas = abs(float(terms.sum())) / max(float(np.sqrt(variance * neighbours)), 1e-300)
            share = float(2 * student_tail(sigmas, max(terms.size / neighbours - 1, 1.0)))
            # a change of the scene's structure may repeat, in few pixels of a tile
            share = share if self_normalised(terms, neighbours)[1] < _REPEATS else 1.0
        else:
            terms, alike = (block_sums(_moved_products(sides.apart, other, by)) for other in others)
            pairs, neighbours = 1, 1.0
            _, share = self_normalised(terms)
        weaker, of_weaker = self_normalised(alike - np.sign(terms.sum()) * terms, neighbours)
        of_both = abs(terms.sum()) <= _CLEARLY * alike.sum()
        if of_both and weaker > 0 and looks * of_weaker < _REPEATS:
            return None  # both sides repeat, and their blocks are copies
        of_candidate = bool(terms.sum() > 0)
        side = "candidate" if of_candidate else "baseline"
        name = f"reused random numbers: noise of the {side} repeats {where}"
        clearer, less_clear = (float(alike.sum()) + sign * abs(float(terms.sum())) for sign in (1, -1))
        # noise that repeats is alike; next to noise that a filter spreads it is the other way round
        probability = min(1.0, looks * share) if clearer > abs(less_clear) else 1.0
        size = clearer / pairs / max(variances[of_candidate], 1e-300)
        findings.append(_finding(name, sides.apart.size, size, terms, probability))
    return min(findings, key=lambda finding: finding.probability)


def shared_numbers(difference: Difference) -> Finding | None:
    """Clearest blocks whose pixels have the same noise on one side.

    Neighbours inside such blocks are alike, and those across a border are not. A filter or a denoiser of one side makes
    all neighbours alike, and more samples all differences smaller. Both leave the contrast at 0.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the contrast as part of the noise. None for small pictures.
    """
    pictures = _apart_and_both(difference)
    if pictures is None:
        return None
    looks, findings = sum(2 * px + px**2 for px in _SHARED_PX), []
    steps = [_in_scale(_steps(pictures[0], axis), _steps(pictures[1], axis)) for axis in (0, 1)]
    for block_px in _SHARED_PX:
        by_axis = [[_contrast(steps[axis], axis, block_px, border) for border in range(block_px)] for axis in (0, 1)]
        rows, columns = by_axis
        tests = [(f"{block_px} rows", *test) for test in rows] + [(f"{block_px} columns", *test) for test in columns]
        tests += [
            (f"{block_px} x {block_px} pixels", row[0] + column[0], row[1] + column[1])
            for row in rows
            for column in columns
        ]
        for group, terms, alike in tests:
            _, share = self_normalised(terms)
            # the difference is smaller inside blocks that share, on whichever side they are
            probability = min(1.0, looks * share) if alike < 0 else 1.0
            side = "candidate" if terms.sum() < 0 else "baseline"
            name = f"shared random numbers: noise of the {side} is alike in groups of {group}"
            size = abs(float(terms.sum())) / max(float((steps[0].apart ** 2).sum()), 1e-300)
            findings.append(_finding(name, steps[0].apart.size, size, terms, probability))
    return min(findings, key=lambda finding: finding.probability)


def filtered_noise(difference: Difference) -> Finding | None:
    """Noise of one side that is more alike between neighbours: a blur, or a wider pixel filter.

    The correlation of each side is its product with the difference, moved, over that unmoved. Structure of the scene
    has none, and more samples change both alike.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the correlation of neighbours of one side less that of the other. None for small pictures.
    """
    pictures = _apart_and_both(difference)
    if pictures is None:
        return None
    alike = 1 + difference.clustering / BLOCK_PX**2
    findings = [f for window in _FILTER_PX for f in _neighbours_alike(pictures, window, alike)]
    looks = len(findings)
    clearest = min(findings, key=lambda finding: finding.probability, default=None)
    if clearest is None:
        return None
    probability = min(1.0, looks * clearest.probability)
    sigma = sigma_of(clearest.size, probability, clearest.degrees)
    return replace(clearest, probability=probability, sigma=sigma)


def _neighbours_alike(
    pictures: tuple[NDArray[np.float64], NDArray[np.float64]], window_px: int, alike: float
) -> list[Finding]:
    """Comparison of the sides' correlations, and of either side's with that of the difference.

    alike : number of neighbouring blocks that correlation makes one.
    """
    sides = _fine(pictures, window_px, _STRUCTURE_OF_BLOCKS)
    moves = ((0, 1), (1, 0))
    near, near_apart = (
        block_sums(np.sum([_moved_products(sides.apart, other, by) for by in moves], axis=0))
        for other in (sides.both, sides.apart_alike)
    )
    unmoved, unmoved_apart = (block_sums(sides.apart * other) for other in (sides.both, sides.apart_alike))
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(unmoved_apart > 0, 1 / (1 + (block_sums(sides.both**2) / unmoved_apart / _NOISY) ** 2), 0.0)
    total = float((weight * unmoved_apart).sum())
    if total <= 0:
        return []
    common = float((weight * near_apart).sum()) / total
    terms, of_difference = near - common * unmoved, near_apart - common * unmoved_apart
    noise = float((weight * unmoved).sum())
    correlation = [
        float((weight * (near_apart + sign * near)).sum()) / max(total + sign * noise, 1e-3 * total) for sign in (-1, 1)
    ]
    filtered = int(correlation[1] > correlation[0])
    name = f"noise of the {('baseline', 'candidate')[filtered]} is filtered: neighbours are more alike"
    size = abs(correlation[1] - correlation[0])
    findings = []
    for part in (terms, 0.5 * (terms + of_difference), 0.5 * (terms - of_difference)):
        _, share = self_normalised(weight * part, alike)
        share = share if correlation[filtered] > _LEAST_CORRELATION else 1.0
        degrees = part.size / alike - 1.0
        findings.append(Finding(name, sides.apart.size, size, sigma_of(size, share, degrees), degrees, share))
    return findings


def _contrast(sides: _Sides, axis: int, block_px: int, border: int) -> tuple[NDArray[np.float64], float]:
    """Contrast of steps inside blocks and across borders, between the sides and of both."""
    position = np.arange(sides.apart.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    inside = np.where(position % block_px == border, -1.0, 1.0 / (block_px - 1))
    return block_sums(sides.apart * sides.both * inside), float((np.abs(sides.apart) * inside).sum())


def _apart_and_both(difference: Difference) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Difference and sum (y, x) of both sides; None for small pictures."""
    if min(difference.level.shape) < _LEAST_SIZE_PX:
        return None
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    both = 2 * difference.level + difference.total
    return np.where(used, difference.total, 0.0), np.where(used, both, 0.0)


def _steps(picture: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """(y, x) step from each pixel to the next along an axis, less the median of its line."""
    step = np.diff(picture, axis=axis, append=np.take(picture, [-1], axis))
    typical = median_filter(step, (1, _LINE_PX) if axis == 0 else (_LINE_PX, 1), mode="nearest")
    return np.asarray(step - typical)


def _fine(
    pictures: tuple[NDArray[np.float64], NDArray[np.float64]], window_px: int, structure: float = _STRUCTURE
) -> _Sides:
    """Difference and sum, less their means over a window, in units of the local scatter."""
    apart, both = (picture - uniform_filter(picture, window_px, mode="nearest") for picture in pictures)
    return _in_scale(apart, both, structure)


def _in_scale(apart: NDArray[np.float64], both: NDArray[np.float64], structure: float = _STRUCTURE) -> _Sides:
    """Fine difference and sum over the difference's local scatter, the sum bounded.

    structure : scatters of the sum from which it is structure.
    """
    scale = median_filter(np.abs(apart), _SCALE_PX, mode="nearest") / _MEDIAN
    least = _ROUNDING * float(np.abs(apart).max())
    first, second = (
        np.clip(np.divide(side, scale, out=np.zeros_like(side), where=scale > least), -limit, limit)
        for side, limit in ((apart, _CUT), (both, _LARGE))
    )
    weight = 1 / (1 + (second / structure) ** 2)
    return _Sides(first, weight * second, weight * first)


def _finding(name: str, pixels: int, size: float, terms: NDArray[np.float64], probability: float) -> Finding:
    """Finding of a sum of products."""
    return Finding(name, pixels, size, sigma_of(size, probability, terms.size), terms.size - 1.0, probability)


def _products(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2 y, 2 x) sums of products of two pictures, one moved, over both signs of the distance."""
    shape = 2 * first.shape[0], 2 * first.shape[1]
    product = np.fft.rfft2(first, shape) * np.conj(np.fft.rfft2(second, shape))
    return np.asarray(np.fft.irfft2(product.real, shape))


def _moved_products(apart: NDArray[np.float64], both: NDArray[np.float64], by: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) products of the candidate with itself, moved, less those of the baseline."""
    return 0.5 * (_overlapping(apart, both, by) + _overlapping(both, apart, by))


def _of_tiles(apart: NDArray[np.float64], both: NDArray[np.float64], tile_px: int) -> tuple[NDArray[np.float64], float]:
    """Products of each pixel over all pairs of tiles (n,), and the variance of their sum.

    The variance is that over random signs of all pixels, which noise that repeats hardly enlarges.
    """
    rows, columns = (size // tile_px for size in apart.shape)
    tiles = [p[: rows * tile_px, : columns * tile_px].reshape(rows, tile_px, columns, tile_px) for p in (apart, both)]
    sums = [part.sum(axis=(0, 2)) for part in tiles]
    squares = [(part**2).sum(axis=(0, 2)) for part in tiles]
    product = tiles[0] * tiles[1]
    same = product.sum(axis=(0, 2))
    variance = squares[0] * squares[1] + same**2 - 2 * (product**2).sum(axis=(0, 2))
    return np.asarray(sums[0] * sums[1] - same).ravel(), float(variance.sum())


def _overlapping(first: NDArray[np.float64], second: NDArray[np.float64], by: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) product of a picture with another, moved; 0 where it has no partner."""
    product = first * np.roll(second, (-by[0], -by[1]), (0, 1))
    if by[0] > 0:
        product[-by[0] :] = 0
    elif by[0] < 0:
        product[: -by[0]] = 0
    if by[1] > 0:
        product[:, -by[1] :] = 0
    return product
