"""Spread of blocks, and each block by its scatter between independent cubes.

By its pixels each block alone decides only far out, since few pixels are not normal. The number of blocks that are off
by two standard deviations is robust against single bright pixels, and against errors that are too small by a half.

Between cubes no neighbour takes part: a change of a few bright pixels is neither set aside as fireflies nor counted as
noise of its surroundings. A firefly is in one cube, which scatters its block. Among ranks it counts as any other pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.utils.distributions import robust_sigma, student_tail
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.optimize import brentq
from scipy.special import bdtrc, digamma, polygamma

from .difference import Finding, common_size, sigma_of
from .pooled_mean import PooledMean

__all__ = ["block_changes", "block_spread", "ranked_squares", "scatter_of_blocks", "steady_sigmas"]

#: Standard deviations from which a block counts.
_SIGMAS = 2.0
#: Factor by which the standard deviations of blocks may be too small.
_ALLOWED = 1.5
#: Fewest blocks of a test.
_MIN_BLOCKS = 12
#: Scatter of the statistics of blocks, from which their standard deviations are too small.
_MOST_SPREAD = 1.2
#: Largest factor by which they are enlarged: what scatters more is a change all over the picture.
_WIDEST_SPREAD = 3.0
#: Degrees of freedom that stand for infinitely many.
_MOST_DEGREES = 1e4
#: Fewest degrees of freedom that the scatter of variances can add.
_LEAST_DEGREES = 1e-2
#: Edges of the squares in which pixels are ranked among cubes, px, odd.
_RANKED_PX = (3, 5, 7, 11)
#: Fewest cubes of a side that are ranked: two gave probabilities below 1e-4 in 3 of 630 equal pairs of filtered noise.
_FEWEST_RANKED = 3
#: Least variance of a square's ranks: where all cubes are equal there is only rounding.
_LEAST_RANK_VARIANCE = 1e-9
#: Statistic of a change of ranks over that of their scatter, up to which unlike noise explains it: gamma-distributed
#: noise of up to 3 times the light, with 1.5 to 16 times the samples, gives 1.9 at most.
_OF_SCATTER = 2.0
#: Statistic of the scatter of ranks that chance gives.
_BY_CHANCE = 1.0
#: Quotient of both sides' variances, in most pixels, from which they have other settings: ranks then differ everywhere.
_UNLIKE = 2.0


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
        (n,) difference and radiance of pixels or cells.
    block
        (n,) number of each one's block.
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


def steady_sigmas(
    difference: NDArray[np.float64], sigma: NDArray[np.float64], degrees: float, *, alike: bool
) -> NDArray[np.float64]:
    """Standard deviations of blocks that fit those and the scatter of all blocks.

    Noise that reaches over a block scatters all of them. A change of a few blocks does not.

    Parameters
    ----------
    difference, sigma
        (n,) difference of each block, and its standard deviation by the block's pixels.
    degrees
        Degrees of freedom of ``sigma``.
    alike
        Whether neighbouring pixels are correlated. A block that a filter left flat does not show its noise then, and
        the variances of other blocks count, too.

    Returns
    -------
    NDArray
        (n,) standard deviations, none smaller than before.
    """
    steady = sigma
    if alike:
        typical, added = _shared_variance(sigma**2, degrees)
        steady = np.maximum(sigma, np.sqrt((degrees * sigma**2 + added * typical) / (degrees + added)))
    statistics = difference / steady
    spread = robust_sigma(statistics - np.median(statistics))
    return steady * (min(spread, _WIDEST_SPREAD) if spread > _MOST_SPREAD else 1.0)


def block_changes(
    baseline: NDArray[np.float64],
    candidate: NDArray[np.float64],
    block: NDArray[np.int64],
    floor: float,
) -> tuple[Finding, ...]:
    """Test of the mean of each block by its scatter between cubes, as Student's t.

    Few cubes give few degrees of freedom. The variances of other blocks, relative to their light, add some where they
    are alike (Smyth 2004). A block's own variance holds where it is larger.

    Parameters
    ----------
    baseline, candidate
        (b, y, x, w) independent cubes of each side.
    block
        (y, x) number of each pixel's block, from 0.
    floor
        Relative standard deviation that is added.

    Returns
    -------
    tuple of Finding
        One for each block with light; none for few blocks or a single cube.
    """
    if min(len(baseline), len(candidate)) < 2:
        return ()
    first, second = (_of_blocks(side, block) for side in (baseline, candidate))
    level = first.mean(axis=0)
    with_light = level > 0
    own_degrees = len(first) + len(second) - 2.0
    squares = sum(np.square(side - side.mean(axis=0)).sum(axis=0) for side in (first, second))
    per_cube = np.divide(squares / own_degrees, level**2, out=np.zeros_like(level), where=with_light)
    with_light &= per_cube > 0
    if with_light.sum() < _MIN_BLOCKS:
        return ()
    difference = (second.mean(axis=0) - level)[with_light] / level[with_light]
    shared = _shared_variance(per_cube[with_light], own_degrees)
    variance, degrees = _moderated(per_cube[with_light], own_degrees, shared)
    sigma = np.sqrt(variance * (1 / len(first) + 1 / len(second)) + floor**2)
    pixels = np.bincount(block.ravel())[np.flatnonzero(with_light)]
    side_length = round(len(level) ** 0.5)
    return tuple(
        Finding(
            f"row {number // side_length + 1}, column {number % side_length + 1}, between cubes",
            int(pixels[index]),
            float(difference[index]),
            float(sigma[index]),
            float(degrees[index]),
            float(2 * student_tail(abs(difference[index]) / sigma[index], degrees[index])),
        )
        for index, number in enumerate(np.flatnonzero(with_light))
    )


def _of_blocks(cubes: NDArray[np.float64], block: NDArray[np.int64]) -> NDArray[np.float64]:
    """(b, block) light of each block in each cube."""
    return np.stack([np.bincount(block.ravel(), cube.sum(axis=-1).ravel()) for cube in cubes])


def ranked_squares(baseline: NDArray[np.float64], candidate: NDArray[np.float64], floor: float = 0.0) -> Finding | None:
    """Square at any place whose pixels rank higher or lower among all cubes than others.

    A pixel's rank among the cubes of both sides has one distribution, whatever its noise: the variances of all squares
    are alike, and few cubes suffice. Ranks are lower where skewed noise has fewer samples, but they scatter more there,
    too. A finding is clearer than twice that scatter.

    Parameters
    ----------
    baseline, candidate
        (b, y, x) independent cubes of each side, summed over wavelengths.
    floor
        Relative difference up to which pixels of two cubes share a rank: noise of a lamp may be less.

    Returns
    -------
    Finding or None
        The size is the square's mean difference over the baseline there. None for small pictures, for few cubes, or for
        unlike noise.
    """
    count, (height, width) = len(baseline), baseline.shape[1:]
    fewest = min(count, len(candidate))
    if fewest < _FEWEST_RANKED or min(height, width) < _MIN_BLOCKS * min(_RANKED_PX):
        return None
    # medians of variances of skewed noise depend on the number of cubes
    variances = [np.maximum(side[:fewest].var(axis=0, ddof=1), 1e-300) for side in (baseline, candidate)]
    if np.abs(np.median(np.log(variances[1] / variances[0]))) > np.log(_UNLIKE):
        return None
    cubes = np.concatenate([baseline, candidate])
    ranks, alike = np.zeros_like(cubes), floor * cubes.mean(axis=0)
    for cube in cubes:
        ranks += np.sign(cubes - cube) * (np.abs(cubes - cube) > alike)
    scatter = ranks**2 - (ranks**2).mean(axis=0)
    looks, findings = float(len(_RANKED_PX) * height * width), []
    for edge in _RANKED_PX:
        (changed, degrees), (scattered, _) = (_of_squares(values, count, edge) for values in (ranks, scatter))
        unlike = _OF_SCATTER * np.maximum(np.abs(scattered) - _BY_CHANCE, 0.0)
        clear = np.maximum(np.abs(changed - np.median(changed)) - unlike, 0.0)
        shares = 2 * looks * student_tail(clear, degrees)
        row, column = (int(n) for n in np.unravel_index(int(shares.argmin()), shares.shape))
        part = np.s_[:, row : row + edge, column : column + edge]
        size = float(candidate[part].mean() / max(float(baseline[part].mean()), 1e-300)) - 1
        name = f"{edge} x {edge} px around x {column + edge // 2} y {row + edge // 2}, ranks between cubes"
        probability, freedom = min(1.0, float(shares[row, column])), float(degrees[row, column])
        sigma = sigma_of(size, probability / looks, freedom)
        bounds = {"bounds_px": (column, row, column + edge, row + edge)}
        findings.append(Finding(name, edge**2, size, sigma, freedom, probability, bounds, looks=looks))
    return min(findings, key=lambda finding: finding.probability)


def _of_squares(values: NDArray[np.float64], count: int, edge: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change of squares' means over its standard deviation, and degrees of freedom.

    Squares lie at all places inside. values : (b, y, x) of the cubes, the first ``count`` of the baseline.
    """
    inside = slice(edge // 2, -(edge // 2))
    means = uniform_filter(values, (0, edge, edge))[:, inside, inside]
    sides, own_degrees = (means[:count], means[count:]), len(values) - 2.0
    per_cube = sum(np.square(side - side.mean(axis=0)).sum(axis=0) for side in sides) / own_degrees
    apart = per_cube[::edge, ::edge]
    apart = apart[apart > _LEAST_RANK_VARIANCE]
    if apart.size < _MIN_BLOCKS:
        return np.zeros_like(per_cube), np.ones_like(per_cube)
    variance, degrees = _moderated(per_cube, own_degrees, _shared_variance(apart, own_degrees))
    sigma = np.sqrt(variance * (1 / count + 1 / (len(values) - count)))
    return (sides[1].mean(axis=0) - sides[0].mean(axis=0)) / sigma, degrees


def _moderated(
    variance: NDArray[np.float64], degrees: float, shared: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variances by their own and the shared one, or the own if larger, with degrees."""
    typical, added = shared
    both = (degrees * variance + added * typical) / (degrees + added)
    is_own = variance > both
    return np.where(is_own, variance, both), np.where(is_own, degrees, degrees + added)


def _shared_variance(variance: NDArray[np.float64], degrees: float) -> tuple[float, float]:
    """Typical variance and the degrees of freedom that it adds, by logarithms (Smyth 2004)."""
    logs = np.log(variance) - digamma(degrees / 2) + np.log(degrees / 2)
    excess = float(np.var(logs, ddof=1)) - float(polygamma(1, degrees / 2))
    if excess <= polygamma(1, _MOST_DEGREES / 2):
        return float(np.exp(logs.mean())), _MOST_DEGREES
    added = float(brentq(lambda d: polygamma(1, d / 2) - excess, _LEAST_DEGREES, _MOST_DEGREES))
    return float(np.exp(logs.mean() + digamma(added / 2) - np.log(added / 2))), added
