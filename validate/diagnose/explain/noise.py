"""Level of the noise in a residual."""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray

__all__ = ["noise_level"]

#: Squares of differences over their level are cut off at this value: edges that the model misses are no noise.
_MAX_SQUARE = 9.0

#: Numerics: largest distance of the pixels whose differences are taken, px: the largest repeat of a mosaic.
_LARGEST_STEP_PX = 16


def _mixed_differences(r: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n,) mixed second differences of one band over 2, at the smallest distance with any."""
    for step in range(1, _LARGEST_STEP_PX + 1):
        four = used[step:, step:] & used[step:, :-step] & used[:-step, step:] & used[:-step, :-step]
        if four.any():
            return (r[step:, step:] - r[step:, :-step] - r[:-step, step:] + r[:-step, :-step])[four] / 2
    return np.zeros(0)


def noise_level(residual: NDArray[np.floating], used: NDArray[np.bool_]) -> float:
    """Chi2 per sample by noise alone, from mixed second differences.

    Mixed differences do not respond to rows, columns or smooth patterns. They are taken between the nearest pixels
    that a band sees: next to each other, behind a mosaic farther apart.

    Parameters
    ----------
    residual
        (band, y, x) residual over sigma.
    used
        (band, y, x) whether a sample is used.

    Returns
    -------
    float
        Chi2 per sample, at most 1: noise is not larger than stated. 1 where no differences can be taken.
    """
    pairs = zip(residual.astype(float), used, strict=True)
    mixed = np.concatenate([_mixed_differences(picture, where) for picture, where in pairs])
    if not mixed.size:
        return 1.0
    level = robust_sigma(mixed) ** 2
    return float(min(level * np.minimum(mixed**2 / level, _MAX_SQUARE).mean(), 1.0))
