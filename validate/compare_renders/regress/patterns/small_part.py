"""Small parts of the picture that differ from their surroundings.

An object that is missing, added or repainted is such a part.

Squares of some sizes are laid over the difference at all places, edges included, since the scene cancels in it. The
median of each is compared with the larger of two scatters, inside the square and around it. Single bright samples and
the corners of a square that an object does not fill do not change a median. A denoiser leaves several noisy spots.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import student_tail
from numpy.typing import NDArray
from scipy.ndimage import median_filter, percentile_filter

from .difference import Difference, Finding, sigma_of

__all__ = ["small_part"]

#: Edges of the squares, px: objects of some pixels to a fifth of a small picture. Quartiles of fewer pixels are chance.
_EDGES_PX = (5, 7, 10)
#: Pixels a side of the surroundings: wider than the largest square.
_AROUND_PX = 17
#: Pixels a side of the median that gives the local level.
_LEVEL_PX = 5
#: Median of the square of a normal number.
_MEDIAN_OF_SQUARE = 0.455
#: Distance of the quartiles of normal numbers, in standard deviations.
_QUARTILES = 1.349
#: Variance of the median of normal numbers over that of their mean.
_OF_MEDIAN = 1.571
#: Fewest independent pixels of a square.
_MIN_INDEPENDENT = 5.0
#: Most degrees of freedom: noise of renderings is not normal.
_MAX_DEGREES = 15.0
#: Least scatter of the surroundings over the typical one.
_LEAST_SCATTER = 0.03
#: Squares elsewhere that may have changed, too.
_OTHERS = 2
#: Factor by which a finding has to be clearer than all others: a denoiser's noisy spots are about alike.
_CLEARER = 2.0
#: Pixels a side of the smallest picture.
_LEAST_PX = 24


def small_part(difference: Difference) -> Finding | None:
    """Square that differs most from its surroundings.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The size is the square's median difference over the local light. None for small pictures, and for noise that
        reaches over more than a few pixels.
    """
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    if min(used.shape) < _LEAST_PX or not used.any() or not difference.of_pixel_filter:
        return None
    level = median_filter(difference.level + 0.5 * difference.total, _LEVEL_PX, mode="nearest")
    relative = difference.total / np.maximum(level, 1e-3 * max(float(difference.level.mean()), 1e-300))
    off = np.where(used, relative - median_filter(relative, _AROUND_PX, mode="nearest"), 0.0)
    around = median_filter(off**2, _AROUND_PX, mode="nearest") / _MEDIAN_OF_SQUARE
    around = np.maximum(around, _LEAST_SCATTER**2 * float(np.median(around[used])) + 1e-300)
    looks = sum(float(used.sum()) / (edge / 2) ** 2 for edge in _EDGES_PX)
    findings = []
    for edge in _EDGES_PX:
        independent = edge**2 / difference.clustering
        if independent >= _MIN_INDEPENDENT:
            findings.append(_clearest(off, around, used, edge, independent, looks))
    return min(findings, key=lambda finding: finding.probability, default=None)


def _clearest(
    off: NDArray[np.float64],
    around: NDArray[np.float64],
    used: NDArray[np.bool_],
    edge: int,
    independent: float,
    looks: float,
) -> Finding:
    """Clearest square of one size.

    off : (y, x) relative difference less that of the surroundings. around : (y, x) its variance there. independent :
    number of independent pixels of a square. looks : squares of all sizes at places that do not overlap much.
    """
    low, middle, high = (percentile_filter(off, part, edge, mode="nearest") for part in (25, 50, 75))
    inside = ((high - low) / _QUARTILES) ** 2
    sigmas = np.abs(middle) / np.sqrt(_OF_MEDIAN * np.maximum(inside, around) / independent)
    degrees = np.where(inside > around, min(independent - 1, _MAX_DEGREES), _MAX_DEGREES)
    shares = 2 * looks * student_tail(sigmas, degrees)
    position = np.unravel_index(int(np.where(used, shares, np.inf).argmin()), shares.shape)
    others = _elsewhere(np.where(used, sigmas, 0.0), position, 2 * edge)
    clear = float(sigmas[position]) > _CLEARER * others
    probability = min(1.0, float(shares[position])) if clear else 1.0
    size, (y, x) = float(middle[position]), (int(n) for n in position)
    name = f"a part of {edge} x {edge} px around x {x} y {y}"
    return Finding(name, edge**2, size, sigma_of(size, probability, _MAX_DEGREES), _MAX_DEGREES, probability)


def _elsewhere(sigmas: NDArray[np.float64], position: tuple[np.intp, ...], reach: int) -> float:
    """Clearest square elsewhere but for some, which may be changes, too."""
    rest = sigmas.copy()
    for _ in range(_OTHERS):
        y, x = position
        rest[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1] = 0.0
        position = np.unravel_index(int(rest.argmax()), rest.shape)
    return float(rest[position])
