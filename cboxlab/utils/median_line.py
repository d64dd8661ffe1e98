"""Straight line through points that hardly depends on those far off."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["median_line"]


def median_line(x: ArrayLike, y: ArrayLike) -> tuple[float, float]:
    """Line with the median slope of all pairs of points (Theil 1950, Sen 1968).

    It is that of ``scipy.stats.theilslopes``, whose import takes half a second.

    Parameters
    ----------
    x, y
        (n,) coordinates; two values of x differ.

    Returns
    -------
    float
        Slope.
    float
        Value at x = 0, from the medians of the coordinates.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    run, rise = x[:, None] - x, y[:, None] - y
    slope = np.median(rise[run > 0] / run[run > 0])
    return float(slope), float(np.median(y) - slope * np.median(x))
