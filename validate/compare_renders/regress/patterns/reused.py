"""Reused random numbers: noise of one side that repeats, or that a block of pixels shares.

A renderer that starts each tile with the same random numbers repeats its noise from tile to tile. One that gives a
block of pixels the same numbers makes neighbours alike, but for those with a border of blocks between them. Structure
of the scene is there on both sides. The products of a side with itself, moved, are therefore compared with those of the
other side. Exchanged sides change the sign of the comparison alone, so that no noise has to be known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .difference import Difference, Finding, self_normalised, sigma_of
from .fine_light import block_sums, fine_light

__all__ = ["reused_numbers", "shared_numbers"]

#: Pixels a side of the window whose mean is subtracted: noise of single pixels remains.
_WINDOW_PX = 3
#: Pixels a side of the window that gives the size of fine structure around a pixel.
_SCALE_PX = 7
#: Least distance at which noise may repeat, px: filters and denoisers correlate nearer pixels.
_LEAST_PX = 6
#: Distances that are compared, from the clearest on.
_CANDIDATES = 4
#: Scatters at which fine structure is cut.
_CUT = 4.0
#: Part of the picture that two pictures, moved, have in common at least.
_COMMON = 0.3
#: Products of one side over the other's, from which that side alone repeats: copies of noise are not independent.
_CLEARLY = 3.0
#: Pixels a side of the smallest picture.
_LEAST_SIZE_PX = 24
#: Pixels a side of the blocks whose pixels may share random numbers: tiles and pixel groups of renderers.
_SHARED_PX = (2, 3, 4, 5, 6, 8)


def reused_numbers(difference: Difference) -> Finding | None:
    """Clearest distance at which the noise of one side repeats.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the part of the fine structure's variance that repeats. None for small pictures.
    """
    sides = _in_own_scale(difference)
    if sides is None:
        return None
    first, second = sides
    repeated = _products(second) - _products(first)
    height, width = first.shape
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) for n in repeated.shape)
    overlap = (1 - down[:, None] / height) * (1 - right[None] / width)
    tested = (np.hypot(down[:, None], right[None]) >= _LEAST_PX) & (overlap >= _COMMON)
    tested[:, repeated.shape[1] // 2 :] = False  # each distance once
    tested[repeated.shape[0] // 2 :, 0] = False
    clear = np.where(tested, np.abs(repeated) / np.sqrt(np.maximum(overlap, _COMMON)), 0.0)
    looks, findings = int(tested.sum()), []
    for index in np.argsort(clear, axis=None)[: -_CANDIDATES - 1 : -1]:
        row, column = (int(i) for i in np.unravel_index(int(index), clear.shape))
        by = row if row < repeated.shape[0] // 2 else row - repeated.shape[0], column
        before, after = (block_sums(_overlapping(side, by)) for side in (first, second))
        terms = after - before
        statistic, share = self_normalised(terms)
        weaker, stronger = sorted((float(part.sum()) for part in (before, after)), key=abs)
        # noise that repeats is alike; next to noise that a filter spreads it is the other way round
        probability = min(1.0, looks * share) if stronger > _CLEARLY * abs(weaker) else 1.0
        size = float(terms.sum()) / max(float((first**2).sum() + (second**2).sum()) / 2, 1e-300)
        side = "candidate" if statistic > 0 else "baseline"
        name = f"reused random numbers: noise of the {side} repeats {by[1]} px right, {by[0]} px down"
        sigma = sigma_of(size, probability, terms.size)
        findings.append(Finding(name, first.size, abs(size), sigma, terms.size - 1.0, probability))
    return min(findings, key=lambda finding: finding.probability, default=None)


def shared_numbers(difference: Difference) -> Finding | None:
    """Clearest blocks whose pixels have the same noise on one side.

    Neighbours inside such blocks are alike, and those across a border are not. A filter or a denoiser of one side makes
    all neighbours alike and leaves the contrast at 0.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the contrast as part of the fine structure's variance. None for small pictures.
    """
    sides = _in_own_scale(difference)
    if sides is None:
        return None
    first, second = sides
    variance = max(float((first**2).sum() + (second**2).sum()) / 2, 1e-300)
    looks, findings = 2 * sum(_SHARED_PX), []
    for axis, by in enumerate(((1, 0), (0, 1))):
        products = [_overlapping(side, by) for side in (first, second)]
        position = np.arange(first.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
        for block_px in _SHARED_PX:
            for border in range(block_px):
                inside = np.where(position % block_px == border, -1.0, 1.0 / (block_px - 1))
                before, after = (block_sums(product * inside) for product in products)
                stronger = max(float(before.sum()), float(after.sum()), key=abs)
                _, share = self_normalised(after - before)
                # neighbours across a border are less alike than those inside, not more
                probability = min(1.0, looks * share) if stronger > 0 else 1.0
                side = "candidate" if after.sum() > before.sum() else "baseline"
                size = abs(float((after - before).sum())) / variance
                lines = ("rows", "columns")[axis]
                name = f"shared random numbers: noise of the {side} is alike in groups of {block_px} {lines}"
                sigma = sigma_of(size, probability, after.size)
                findings.append(Finding(name, first.size, size, sigma, after.size - 1.0, probability))
    return min(findings, key=lambda finding: finding.probability)


def _in_own_scale(difference: Difference) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Fine structure (y, x) of both sides over its local size, cut; None without any."""
    if min(difference.level.shape) < _LEAST_SIZE_PX:
        return None
    sides = fine_light(difference, _WINDOW_PX)
    # edges are as large as the noise around them then; the scale is the same for exchanged sides
    scale = np.sqrt(median_filter(sides[0] ** 2 + sides[1] ** 2, _SCALE_PX, mode="nearest"))
    if not scale.any():
        return None
    scale = np.maximum(scale, float(np.median(scale[scale > 0])))
    first, second = (np.where(difference.smooth, np.clip(side / scale, -_CUT, _CUT), 0.0) for side in sides)
    return first, second


def _products(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2 y, 2 x) sums of products of a picture with itself, moved."""
    shape = 2 * picture.shape[0], 2 * picture.shape[1]
    return np.asarray(np.fft.irfft2(np.abs(np.fft.rfft2(picture, shape)) ** 2, shape))


def _overlapping(picture: NDArray[np.float64], by: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) product of a picture with itself, moved; 0 where it has no partner."""
    moved = np.roll(picture, (-by[0], -by[1]), (0, 1))
    product = picture * moved
    if by[0] > 0:
        product[-by[0] :] = 0
    elif by[0] < 0:
        product[: -by[0]] = 0
    if by[1] > 0:
        product[:, -by[1] :] = 0
    return product
