"""Blocks of the picture, by the scatter of each block between independent cubes.

No neighbour takes part: a change of a few bright pixels is neither set aside as fireflies nor counted as noise of its
surroundings. A firefly is in one cube, which scatters its block.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import student_tail
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from .patterns import Finding

__all__ = ["block_changes"]

#: Fewest blocks with light whose scatters are compared.
_FEWEST_BLOCKS = 12
#: Degrees of freedom that stand for infinitely many.
_MOST_DEGREES = 1e4
#: Fewest degrees of freedom that the scatter of variances can add.
_LEAST_DEGREES = 1e-2


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
    if with_light.sum() < _FEWEST_BLOCKS:
        return ()
    difference = (second.mean(axis=0) - level)[with_light] / level[with_light]
    typical, added = _shared_variance(per_cube[with_light], own_degrees)
    moderated = (own_degrees * per_cube[with_light] + added * typical) / (own_degrees + added)
    is_own = per_cube[with_light] > moderated
    variance = np.where(is_own, per_cube[with_light], moderated) * (1 / len(first) + 1 / len(second))
    degrees = np.where(is_own, own_degrees, own_degrees + added)
    sigma = np.sqrt(variance + floor**2)
    pixels = np.bincount(block.ravel())[np.flatnonzero(with_light)]
    side_length = round(len(level) ** 0.5)
    return tuple(
        Finding(
            f"row {number // side_length + 1}, column {number % side_length + 1} between cubes",
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


def _shared_variance(variance: NDArray[np.float64], degrees: float) -> tuple[float, float]:
    """Typical variance and the degrees of freedom that it adds, by logarithms (Smyth 2004)."""
    logs = np.log(variance) - digamma(degrees / 2) + np.log(degrees / 2)
    excess = float(np.var(logs, ddof=1)) - float(polygamma(1, degrees / 2))
    if excess <= polygamma(1, _MOST_DEGREES / 2):
        return float(np.exp(logs.mean())), _MOST_DEGREES
    added = float(brentq(lambda d: polygamma(1, d / 2) - excess, _LEAST_DEGREES, _MOST_DEGREES))
    return float(np.exp(logs.mean() + digamma(added / 2) - np.log(added / 2))), added
