"""Outliers: single pixels far from their neighbours (fireflies), set aside and reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import NORMAL_OVER_MEDIAN
from numpy.typing import NDArray
from scipy.ndimage import label, median_filter

from .noise import local_range, row_sums, smooth_variance

__all__ = ["Trimmed", "trimmed"]

#: Standard deviations of its neighbourhood beyond which a pixel is an outlier: normal noise has none in 10^8 pixels.
_OUTLIER_SIGMAS = 6.0
#: Mean of a band over that of the brightest one, below which it is not tested.
_MIN_LIGHT = 1e-3
#: Largest group of touching outliers: 3 x 3 pixels, as far as a pixel filter spreads a firefly. Larger groups are a
#: difference of the pictures.
_MAX_GROUP_PX = 9
#: Part of an outermost row or column from which its outliers are no fireflies, which hit one pixel in a hundred.
_BORDER_PART = 0.25
#: Outliers whose neighbours are gathered at once, which bounds memory.
_AT_ONCE = 1000


@dataclass(frozen=True, eq=False)
class Trimmed:
    """A difference and its baseline, without outliers."""

    #: (y, x, w) difference, outliers replaced by the medians of their neighbours.
    difference: NDArray[np.float64]
    #: (y, x, w) radiance of the baseline, outliers replaced in the same way.
    level: NDArray[np.float64]
    #: (y, x) pixels that were replaced.
    outlier: NDArray[np.bool_]
    #: (y, x) radiance, summed over wavelengths, that was set aside in the difference.
    excess: NDArray[np.float64]


def trimmed(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    variance: NDArray[np.float64],
    degrees: float,
    lamp: NDArray[np.bool_],
) -> Trimmed:
    """Difference and level with outliers replaced by the medians of their neighbours.

    An outlier lies more than 6 standard deviations and one local range of the level from the ratio of its neighbours.
    The local range spares edges that moved. Both the sum over wavelengths is tested and the sum of bands over their
    means, in which a white firefly is far larger where the picture has little light.

    Parameters
    ----------
    difference
        (y, x, w) difference of two pictures.
    level
        (y, x, w) radiance of the baseline.
    variance
        (y, x, w) variance of the difference.
    degrees
        Degrees of freedom behind each variance.
    lamp
        (y, x) pixels at the lamp, where nothing is set aside: it may be a single row of pixels.

    Returns
    -------
    Trimmed
        Without outliers it holds ``difference`` and ``level`` themselves, no copies.
    """
    total, ground = difference.sum(axis=-1), level.sum(axis=-1)
    means = level.mean(axis=(0, 1))
    with_light = means > _MIN_LIGHT * means.max()
    even = np.divide(1.0, means, out=np.zeros_like(means), where=with_light)
    widest = np.stack([np.sqrt(row).sum(axis=-1) for row in variance]) ** 2
    outlier = _far(total, ground, widest, degrees)
    outlier |= _far(difference @ even, level @ even, row_sums(variance, even, root=True) ** 2, degrees)
    outlier &= _in_small_groups(outlier) & ~lamp & ~_changed_border(outlier)
    if not outlier.any():
        return Trimmed(difference, level, outlier, np.zeros_like(total))
    clean, base = difference.copy(), level.copy()
    rows, columns = np.nonzero(outlier)
    clean[rows, columns] = _around(difference, outlier, rows, columns)
    base[rows, columns] = _around(level, outlier, rows, columns)
    return Trimmed(clean, base, outlier, np.where(outlier, total - clean.sum(axis=-1), 0.0))


def _far(total: NDArray, ground: NDArray, widest: NDArray, degrees: float) -> NDArray[np.bool_]:
    """(y, x) outliers of a sum over wavelengths.

    widest : (y, x) its variance for fully correlated wavelengths, the largest possible.
    """
    quiet = median_filter(ground, 3, mode="nearest")
    scale = np.maximum(quiet, 1e-6 * max(float(quiet.max()), 1e-300))
    ratio = median_filter(total / scale, 7, mode="reflect")  # "nearest" repeats a border until it is most of a corner
    residual = total - ratio * ground
    sigma = np.sqrt(smooth_variance(quiet, widest, degrees))
    spread = NORMAL_OVER_MEDIAN * median_filter(np.abs(residual), 7, mode="reflect")
    allowed = _OUTLIER_SIGMAS * np.maximum(np.minimum(sigma, 3 * spread), spread) + local_range(ground) * (
        1 + np.abs(ratio)
    )
    return np.asarray((np.abs(residual) > allowed) | (np.abs(ground - quiet) > allowed + quiet))


def _changed_border(outlier: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(y, x) outermost rows and columns with more outliers than fireflies make."""
    border = np.zeros_like(outlier)
    for line in (np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]):
        border[line] |= outlier[line].mean() > _BORDER_PART
    return border


def _in_small_groups(outlier: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(y, x) pixels of groups small enough for a firefly spread by a pixel filter."""
    groups, _ = label(outlier, np.ones((3, 3)))
    return np.bincount(groups.ravel())[groups] <= _MAX_GROUP_PX


def _around(picture: NDArray, outlier: NDArray[np.bool_], rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """(n, w) medians of the 5 x 5 pixels around each outlier that are none; 0 where all are."""
    height, width = outlier.shape
    if len(rows) > _AT_ONCE:
        parts = (slice(first, first + _AT_ONCE) for first in range(0, len(rows), _AT_ONCE))
        return np.concatenate([_around(picture, outlier, rows[part], columns[part]) for part in parts])
    away = np.arange(-2, 3)
    down, right = (grid.ravel() for grid in np.meshgrid(away, away, indexing="ij"))
    y, x = rows[:, None] + down, columns[:, None] + right
    inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
    values = np.where((inside & ~outlier[y, x])[..., None], picture[y, x], np.nan)
    lonely = np.isnan(values[..., 0]).all(axis=1)
    values[lonely] = 0.0
    return np.nanmedian(values, axis=1)
