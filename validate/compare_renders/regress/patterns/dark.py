"""Black pixels: dark ones among lit neighbours, of one side alone.

Noise of light is skewed towards the bright side. A mean of non-negative samples whose relative error is a seventh is
never dark by chance: all samples would have to be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .difference import Finding

__all__ = ["dark_pixels"]

#: Part of the neighbours' median below which a pixel is dark; negative ones are of filters with negative lobes.
_DARK_PART = 0.02
#: Part of the neighbours' median that the other side has at least.
_LIT_PART = 0.5
#: Largest relative scatter of neighbours at which a dark pixel is no noise.
_MAX_SCATTER = 0.15
#: Pixels a side of the neighbourhood.
_WINDOW_PX = 7


def dark_pixels(
    baseline: NDArray[np.float64], candidate: NDArray[np.float64], smooth: NDArray[np.bool_], critical: float
) -> Finding:
    """Count of pixels that are dark in one picture alone.

    Parameters
    ----------
    baseline, candidate
        (y, x) pictures with their outliers.
    smooth
        (y, x) pixels away from edges, lamp and border.
    critical
        Probability that a finding states as its own.

    Returns
    -------
    Finding
        The size is the part of smooth pixels.
    """
    medians = [median_filter(picture, _WINDOW_PX, mode="nearest") for picture in (baseline, candidate)]
    dark = [_dark(p, m, smooth) for p, m in zip((baseline, candidate), medians, strict=True)]
    bright = [p > _LIT_PART * m for p, m in zip((baseline, candidate), medians, strict=True)]
    count = int((dark[0] & bright[1]).sum() + (dark[1] & bright[0]).sum())
    size = count / max(int(smooth.sum()), 1)
    probability = critical / 1e6 if count else 1.0
    side = "" if not count else " of the candidate" if (dark[1] & bright[0]).any() else " of the baseline"
    return Finding(f"black pixels{side}", count, size, size / 10 if count else 1.0, 12.0, probability)


def _dark(picture: NDArray, median: NDArray, smooth: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(y, x) dark pixels among quiet lit ones."""
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(median > 0, np.abs(picture / median - 1), np.inf)
    scatter = 1.4826 * median_filter(np.where(np.isfinite(off), off, 1e9), _WINDOW_PX, mode="nearest")
    return smooth & (picture >= 0) & (picture < _DARK_PART * median) & (scatter < _MAX_SCATTER)
