"""Spread of blocks: more blocks off by two standard deviations than noise allows.

Each block alone decides only far out, since its few pixels are not normal. Their count is robust against single bright
pixels, and against standard deviations that are too small by a half.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.utils.distributions import student_tail
from numpy.typing import NDArray
from scipy.special import bdtrc

from .difference import Finding, common_size, sigma_of
from .pooled_mean import PooledMean

__all__ = ["block_spread", "scatter_of_blocks"]

#: Standard deviations from which a block counts.
_SIGMAS = 2.0
#: Factor by which the standard deviations of blocks may be too small.
_ALLOWED = 1.5
#: Fewest blocks of a test.
_MIN_BLOCKS = 12


def block_spread(blocks: Sequence[PooledMean], clustering: float) -> Finding | None:
    """Count of blocks that differ, as a binomial test.

    Parameters
    ----------
    blocks
        Tests of the blocks.
    clustering
        Number of pixels that correlation makes one.

    Returns
    -------
    Finding or None
        The size is the root mean square of the blocks' differences. None for few blocks, or where noise reaches from
        block to block.
    """
    if len(blocks) < _MIN_BLOCKS or clustering > np.median([block.pixels for block in blocks]):
        return None
    count = sum(abs(block.statistic) > _SIGMAS for block in blocks)
    by_chance = float(np.mean([2 * student_tail(_SIGMAS / _ALLOWED, block.degrees) for block in blocks]))
    probability = float(bdtrc(count - 1, len(blocks), by_chance)) if count else 1.0
    size = float(np.sqrt(np.mean([block.difference**2 for block in blocks])))
    degrees = len(blocks) - 1.0
    name = f"{count} of {len(blocks)} blocks off by {_SIGMAS:g} sigmas"
    pixels = sum(block.pixels for block in blocks)
    return Finding(name, pixels, size, sigma_of(size, probability, degrees), degrees, probability)


def scatter_of_blocks(
    difference: NDArray[np.float64], level: NDArray[np.float64], block: NDArray[np.int64], alike: float
) -> tuple[float, float]:
    """Variance of a sum by the scatter of its blocks about its mean.

    Estimates by pixels are too small for noise that reaches further than that of a pixel filter.

    Parameters
    ----------
    difference, level
        (n,) difference and radiance of the pixels.
    block
        (n,) number of each pixel's block.
    alike
        Number of neighbouring blocks that correlation makes one.

    Returns
    -------
    variance
        The variance of the sum of ``difference``; 0 for few blocks.
    degrees
        Its degrees of freedom.
    """
    parts, levels = (np.asarray(np.bincount(block, values), float) for values in (difference, level))
    _, sigma, degrees, _ = common_size(parts, np.maximum(levels, 0.0), alike)
    return (float((sigma * levels.sum()) ** 2), degrees) if np.isfinite(sigma) else (0.0, np.inf)
