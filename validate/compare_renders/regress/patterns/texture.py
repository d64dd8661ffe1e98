"""Textures: single pixels that differ by more than their stated errors, in no pattern.

The square of a difference has its variance as mean, whatever its distribution and its correlation with neighbours. A
variance from independent batches has that mean, too. Their difference is tested as a self-normalised sum.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import student_quantile
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter, uniform_filter

from .difference import Difference, Finding, self_normalised

__all__ = ["FIXED_TEXTURE", "fine_structure", "textures"]

#: Name of a texture of smooth parts.
FIXED_TEXTURE = "fixed texture"

#: Variance over the stated one that is allowed: errors of batches that share low-discrepancy numbers.
_ALLOWED = 1.5
#: Fine structure that a change carries, over the local change times the baseline's structure: for powers up to 2.
_CARRIED = 2.0
#: Pixels a side of a window whose mean is no texture.
_WINDOW_PX = 5
#: Pixels a side of the blocks whose sums are independent in smooth parts, where filters correlate pixels.
_BLOCK_PX = 4
#: Fewest blocks or pixels of a test.
_MIN_TERMS = 24
#: Smallest relative size of a texture: accuracy of single precision and of estimators.
_FLOOR = 1e-4


def textures(difference: Difference) -> list[Finding]:
    """Scatter of single pixels beyond their stated errors, by group of pixels.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    list of Finding
        One for each group with enough pixels; none where a side states no errors.
    """
    if difference.variance is None:
        return []
    findings = []
    for name, group in difference.groups.items():
        finding = _tested(difference, difference.variance, name, group)
        if finding is not None:
            findings.append(finding)
    return findings


def fine_structure(difference: Difference) -> float:
    """Scatter of the baseline's pixels about their surroundings in smooth parts, noise included.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    float
        Root mean square over the mean light; 0 without smooth parts.
    """
    if not difference.smooth.any():
        return 0.0
    level = difference.level
    off = (level - median_filter(level, _WINDOW_PX, mode="nearest"))[difference.smooth]
    return float(np.sqrt(np.mean(off**2)) / max(float(level[difference.smooth].mean()), 1e-300))


def _tested(difference: Difference, variance: NDArray, name: str, group: NDArray[np.bool_]) -> Finding | None:
    """Test of one group."""
    level = median_filter(difference.level, _WINDOW_PX, mode="nearest")
    if name == "smooth parts":
        share = np.maximum(uniform_filter(group.astype(float), _WINDOW_PX), 1e-9)
        mean = uniform_filter(np.where(group, difference.relative, 0.0), _WINDOW_PX) / share
        off = (difference.relative - mean) * np.maximum(level, 1e-3 * level.mean())
        scale = np.sqrt(_around(variance, group))
        # a change in proportion to the picture, or to a power of it, carries the picture's own fine structure
        carried = _CARRIED * mean * (difference.level - level)
        blocks = _blocks(difference.level.shape)
    else:
        # light at edges varies by the local range, so that squares over it are comparable
        off, carried = difference.total, np.zeros(group.shape)
        quiet = median_filter(difference.level, 3, mode="nearest")
        scale = maximum_filter(quiet, 3) - minimum_filter(quiet, 3) + 1e-2 * level
        blocks = np.arange(group.size).reshape(group.shape)
    excess = off**2 - _ALLOWED * variance - (_FLOOR * difference.level) ** 2 - carried**2
    used = group & (scale > 0)
    if not used.any():
        return None
    sums = np.bincount(blocks[used], excess[used] / scale[used] ** 2).astype(float)
    terms = sums[np.bincount(blocks[used]) > 0]
    if terms.size < _MIN_TERMS:
        return None
    pixels_alike = difference.clustering * terms.size / int(used.sum())
    statistic, probability = self_normalised(terms, max(1.0, pixels_alike))
    mean_level = float(difference.level[used].mean())
    size = float(np.sqrt(max(np.mean(off[used] ** 2 - variance[used]), 0.0))) / max(mean_level, 1e-300)
    share_ = probability / 2 if statistic > 0 else 1.0
    student = float(student_quantile(max(share_, 1e-300) / 2, terms.size - 1)) if share_ < 1 else 0.0
    sigma = size / student if student > 0 and size > 0 else _FLOOR
    label = FIXED_TEXTURE if name == "smooth parts" else f"single pixels of {name}"
    ratio = float(
        np.sqrt((off[used] ** 2 / scale[used] ** 2).sum() / max((variance[used] / scale[used] ** 2).sum(), 1e-300))
    )
    return Finding(label, int(used.sum()), size, sigma, terms.size - 1.0, share_, {"times_the_stated_error": ratio})


def _around(variance: NDArray[np.float64], group: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(y, x) mean variance of the pixels around each one, its own left out."""
    count = uniform_filter(group.astype(float), _WINDOW_PX) * _WINDOW_PX**2 - group
    total = uniform_filter(np.where(group, variance, 0.0), _WINDOW_PX) * _WINDOW_PX**2 - np.where(group, variance, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(count > 0.5, np.maximum(total, 0.0) / count, 0.0)


def _blocks(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """(y, x) number of each pixel's block."""
    rows, columns = (np.arange(size) // _BLOCK_PX for size in shape)
    return rows[:, None] * (int(columns[-1]) + 1) + columns
