"""Straight line through points by medians."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["median_line"]


def median_line(x: ArrayLike, y: ArrayLike) -> tuple[float, float]:
    """Slope and intercept by the estimator of Theil (1950) and Sen (1968).

    They are those of `scipy.stats.theilslopes`, whose import takes longer than the line.

    Parameters
    ----------
    x
        (n,) positions, two or more.
    y
        (n,) values.

    Returns
    -------
    float
        Median of the slopes between points of different positions; nan if all positions are the same.
    float
        Value at 0 of the line with that slope through the medians of positions and values.
    """
    positions, values = np.asarray(x, float), np.asarray(y, float)
    runs, rises = positions[:, None] - positions, values[:, None] - values
    slopes = rises[runs > 0] / runs[runs > 0]
    slope = float(np.median(slopes)) if slopes.size else float("nan")
    return slope, float(np.median(values) - slope * np.median(positions))
