"""Level of the noise in a residual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["noise_level"]

#: Median of the absolute value of a standard normal variable.
_MEDIAN_OF_NORMAL = 0.6745

#: Squares of differences over their level are cut off at this value: edges that the model misses are no noise.
_MAX_SQUARE = 9.0


def noise_level(residual: NDArray[np.floating], used: NDArray[np.bool_]) -> float:
    """Chi2 per sample by noise alone, from mixed second differences.

    Mixed differences do not respond to rows, columns or smooth patterns.

    Parameters
    ----------
    residual
        (band, y, x) residual over sigma.
    used
        (band, y, x) whether a sample is used.

    Returns
    -------
    float
        Chi2 per sample, at most 1: noise is not larger than stated.
    """
    r = residual.astype(float)
    four = used[:, 1:, 1:] & used[:, 1:, :-1] & used[:, :-1, 1:] & used[:, :-1, :-1]
    mixed = (r[:, 1:, 1:] - r[:, 1:, :-1] - r[:, :-1, 1:] + r[:, :-1, :-1])[four] / 2
    level = (np.median(np.abs(mixed)) / _MEDIAN_OF_NORMAL) ** 2
    return float(min(level * np.minimum(mixed**2 / level, _MAX_SQUARE).mean(), 1.0))
