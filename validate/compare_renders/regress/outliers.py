"""Single pixels far from their neighbours (fireflies): set aside for pooled statistics, and reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, median_filter

from .noise import local_range, smooth_variance

__all__ = ["Trimmed", "trimmed"]

#: A pixel counts as an outlier beyond so many standard deviations of its neighbourhood.
_SIGMAS = 6.0
#: Bands with less than this part of the brightest one's mean tell nothing.
_DARK = 1e-3
#: Outliers that touch each other in greater number are a difference of the pictures.
_LARGEST_GROUP = 9


@dataclass(frozen=True, eq=False)
class Trimmed:
    """difference, level : (y, x, w), outliers replaced by what their neighbours say.

    outlier : (y, x). excess : (y, x) radiance, summed over wavelengths, that was set aside in the difference.
    """

    difference: NDArray[np.float64]
    level: NDArray[np.float64]
    outlier: NDArray[np.bool_]
    excess: NDArray[np.float64]


def trimmed(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    variance: NDArray[np.float64],
    degrees: float,
    lamp: NDArray[np.bool_],
) -> Trimmed:
    """An outlier lies 6 standard deviations and one local range of the level from its neighbours' ratio.

    difference, level, variance : (y, x, w). lamp : (y, x) at the lamp, which may be a single row of pixels: there
    nothing is set aside. The local range lets edges that moved stay. Sums over wavelengths are
    looked at, and sums of bands over their means: a white firefly is far larger where the picture has little light.
    """
    total, ground = difference.sum(axis=-1), level.sum(axis=-1)
    means = level.mean(axis=(0, 1))
    lit = means > _DARK * means.max()
    even = np.divide(1.0, means, out=np.zeros_like(means), where=lit)
    outlier = _far(total, ground, np.sqrt(variance).sum(axis=-1) ** 2, degrees)
    outlier |= _far(difference @ even, level @ even, (np.sqrt(variance) @ even) ** 2, degrees)
    outlier &= _alone(outlier) & ~lamp
    clean, base = difference.copy(), level.copy()
    rows, columns = np.nonzero(outlier)
    clean[rows, columns] = _around(difference, outlier, rows, columns)
    base[rows, columns] = _around(level, outlier, rows, columns)
    return Trimmed(clean, base, outlier, np.where(outlier, total - clean.sum(axis=-1), 0.0))


def _far(total: NDArray, ground: NDArray, widest: NDArray, degrees: float) -> NDArray[np.bool_]:
    """(y, x) of sums over wavelengths (y, x); widest : their variance for fully correlated wavelengths, the widest."""
    quiet = median_filter(ground, 3, mode="nearest")
    scale = np.maximum(quiet, 1e-6 * max(float(quiet.max()), 1e-300))
    ratio = median_filter(total / scale, 7, mode="nearest")
    left = total - ratio * ground
    sigma = np.sqrt(smooth_variance(quiet, widest, degrees))
    spread = 1.4826 * median_filter(np.abs(left), 7, mode="nearest")
    allowed = _SIGMAS * np.maximum(np.minimum(sigma, 3 * spread), spread) + local_range(ground) * (1 + np.abs(ratio))
    return np.asarray((np.abs(left) > allowed) | (np.abs(ground - quiet) > allowed + quiet))


def _alone(outlier: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(y, x) pixels of groups so small that a firefly, spread by a pixel filter, may have made them."""
    groups, _ = label(outlier, np.ones((3, 3)))
    return np.bincount(groups.ravel())[groups] <= _LARGEST_GROUP


def _around(picture: NDArray, outlier: NDArray[np.bool_], rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """(n, w) medians of the 5 x 5 pixels around each place that are no outliers themselves; 0 where all are."""
    height, width = outlier.shape
    away = np.arange(-2, 3)
    down, right = (grid.ravel() for grid in np.meshgrid(away, away, indexing="ij"))
    y, x = rows[:, None] + down, columns[:, None] + right
    inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
    values = np.where((inside & ~outlier[y, x])[..., None], picture[y, x], np.nan)
    lonely = np.isnan(values[..., 0]).all(axis=1)
    values[lonely] = 0.0
    return np.nanmedian(values, axis=1)
