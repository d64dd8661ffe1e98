"""Gaussian blur of pictures whose pixels are means over squares.

A Gaussian sampled at whole pixels is too narrow below 0.7 px: at 0.3 px its standard deviation is 0.09 px.
Here the kernel is the one that best predicts the blurred pixels from the sharp ones for edges at random
places: the Wiener filter Sum_k G(w + 2 pi k) P(w + 2 pi k) / Sum_k P(w + 2 pi k), where P = 1 / w^4 is the
spectrum of such edges seen through square pixels and G = exp(-sigma^2 w^2 / 2). Only kernels without negative
values are admitted, since others would ring around the lamp.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.optimize import nnls

__all__ = ["blur", "kernel"]

_ALIASES = 8
_FREQUENCIES = 128

#: From this standard deviation on, px, a Gaussian sampled at whole pixels is no narrower.
_SAMPLED = 2.0


@lru_cache(maxsize=256)
def kernel(sigma_px: float) -> NDArray[np.float64]:
    """(2 n + 1,) weights >= 0 with sum 1, symmetric; a single 1 for no blur. sigma_px : >= 0."""
    if sigma_px == 0:
        return np.ones(1)
    reach = int(np.ceil(5 * sigma_px)) + 1
    weights = _sampled(sigma_px, reach) if sigma_px >= _SAMPLED else _predicting(sigma_px, reach)
    weights.flags.writeable = False  # the cache hands it out again
    return weights


def _sampled(sigma_px: float, reach: int) -> NDArray[np.float64]:
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    return np.asarray(weights / weights.sum())


def _predicting(sigma_px: float, reach: int) -> NDArray[np.float64]:
    """The positive kernel that best predicts blurred pixels."""
    frequency = np.pi * (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES
    aliased = frequency[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
    power = aliased**-4.0
    total = power.sum(axis=1)
    wanted = (np.exp(-0.5 * (sigma_px * aliased) ** 2) * power).sum(axis=1) / total
    # Weights w_n and w_-n = w_n act as 1 + Sum_n 2 w_n (cos(n w) - 1), which keeps the sum at 1.
    design = 2 * (np.cos(np.outer(frequency, np.arange(1, reach + 1))) - 1)
    side, _ = nnls(design * np.sqrt(total)[:, None], (wanted - 1) * np.sqrt(total))
    return np.concatenate([side[::-1], [1 - 2 * side.sum()], side])


def blur(image: NDArray[np.float64], sigma_px: float) -> NDArray[np.float64]:
    """The image (y, x) blurred by a Gaussian; beyond the border the outermost pixels are repeated."""
    weights = kernel(float(sigma_px))
    rows = correlate1d(image, weights, axis=0, mode="nearest")
    return correlate1d(rows, weights, axis=1, mode="nearest")
