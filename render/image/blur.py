"""Gaussian blur of images whose pixels are means over squares.

A Gaussian sampled at whole pixels is too narrow below 0.7 px: for 0.3 px its standard deviation is 0.09 px. The kernel
used here predicts the blurred pixels best from the sharp ones, for edges at random positions. It is the Wiener filter

    Sum_k G(w + 2 pi k) P(w + 2 pi k) / Sum_k P(w + 2 pi k)

with P = 1 / w^4, the power spectrum of such edges in square pixels, and G = exp(-sigma^2 w^2 / 2). Kernels with
negative values are excluded: they would cause ringing around the lamp.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

__all__ = ["blur", "kernel"]

#: Largest k of the sums over aliases.
_ALIASES = 8
#: Number of frequencies w, between 0 and pi, at which the kernel is fitted.
_FREQUENCIES = 128

#: Smallest standard deviation for which a Gaussian sampled at whole pixels is accurate, px.
_SAMPLED_FROM_PX = 2.0


@lru_cache(maxsize=256)
def kernel(sigma_px: float) -> NDArray[np.float64]:
    """Blur kernel along one axis.

    Parameters
    ----------
    sigma_px
        Standard deviation of the Gaussian, >= 0, px.

    Returns
    -------
    NDArray
        (2 n + 1,) weights >= 0 with sum 1, symmetric; a single 1 for no blur. It is cached and read-only.
    """
    if sigma_px == 0:
        return np.ones(1)
    reach = int(np.ceil(5 * sigma_px)) + 1
    weights = _sampled(sigma_px, reach) if sigma_px >= _SAMPLED_FROM_PX else _wiener(sigma_px, reach)
    weights.flags.writeable = False  # the cached array is shared
    return weights


def _sampled(sigma_px: float, reach: int) -> NDArray[np.float64]:
    """Gaussian sampled at whole pixels, normalised."""
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    return np.asarray(weights / weights.sum())


def _wiener(sigma_px: float, reach: int) -> NDArray[np.float64]:
    """The Wiener kernel without negative weights, by non-negative least squares in frequency."""
    from scipy.optimize import nnls  # slow to import

    frequency = np.pi * (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES
    aliased = frequency[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
    power = aliased**-4.0
    total = power.sum(axis=1)
    response = (np.exp(-0.5 * (sigma_px * aliased) ** 2) * power).sum(axis=1) / total
    # The response of symmetric weights w_n with sum 1 is 1 + Sum_n 2 w_n (cos(n w) - 1).
    design = 2 * (np.cos(np.outer(frequency, np.arange(1, reach + 1))) - 1)
    side, _ = nnls(design * np.sqrt(total)[:, None], (response - 1) * np.sqrt(total))
    return np.concatenate([side[::-1], [1 - 2 * side.sum()], side])


def blur(image: NDArray[np.float64], sigma_px: float) -> NDArray[np.float64]:
    """Gaussian blur; the border pixels are repeated outside.

    Parameters
    ----------
    image
        (y, x) image.
    sigma_px
        Standard deviation of the Gaussian, >= 0, px.

    Returns
    -------
    NDArray
        (y, x) blurred image.
    """
    weights = kernel(float(sigma_px))
    rows = correlate1d(image, weights, axis=0, mode="nearest")
    return correlate1d(rows, weights, axis=1, mode="nearest")
