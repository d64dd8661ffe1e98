"""Defective pixels, found in dark and flat frames by robust thresholds with a stated false-alarm rate."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import norm

__all__ = ["FALSE_ALARMS_PER_IMAGE", "dead_pixels", "hot_pixels", "vignetted_pixels"]

#: Mean number of sound pixels flagged in an image by each test, if sound pixels are normally distributed.
FALSE_ALARMS_PER_IMAGE = 0.01

_MAD_TO_SIGMA = 1.4826
_VIGNETTED_SHARE = 0.1
# 5 x 5 without the pixel itself: it would often be the median, and the spread would be underestimated.
_NEIGHBOURS = np.ones((5, 5), bool)
_NEIGHBOURS[2, 2] = False


def _robust(values: NDArray[np.float64], smallest_sigma: float) -> NDArray[np.float64]:
    middle = np.median(values)
    sigma = max(_MAD_TO_SIGMA * float(np.median(np.abs(values - middle))), smallest_sigma)
    return (values - middle) / sigma


def hot_pixels(dark: NDArray[np.float64], smallest_sigma_dn: float) -> NDArray[np.bool_]:
    """(y, x) True where the dark level (y, x) in DN is unusually high.

    The standard deviation is estimated from the median absolute deviation, and is at least smallest_sigma_dn (the
    noise, for frames whose median deviation rounds to 0). Threshold: FALSE_ALARMS_PER_IMAGE.
    """
    return _robust(dark, smallest_sigma_dn) > norm.isf(FALSE_ALARMS_PER_IMAGE / dark.size)


def dead_pixels(response: NDArray[np.float64], mosaic: bool = False) -> NDArray[np.bool_]:
    """(y, x) True where the flat response (y, x) is unusually low compared with the pixel's 5 x 5 neighbours.

    Tests the ratio to the neighbours' median against the median absolute deviation of this ratio; threshold:
    FALSE_ALARMS_PER_IMAGE. mosaic : compare only pixels of the same position in the mosaic's 2 x 2 cell.
    """
    step = 2 if mosaic else 1
    ratio = np.empty_like(response)
    for row, column in itertools.product(range(step), range(step)):
        plane = response[row::step, column::step]
        # Odd reflection continues the gradient of the light beyond the edge; even reflection would reverse it.
        padded = np.pad(plane, 2, mode="reflect", reflect_type="odd")
        middle = median_filter(padded, footprint=_NEIGHBOURS)[2:-2, 2:-2]
        ratio[row::step, column::step] = plane / np.maximum(middle, 1e-6)
    return _robust(ratio, 1e-6) < -norm.isf(FALSE_ALARMS_PER_IMAGE / response.size)


def vignetted_pixels(response: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(y, x) True where the flat is below a tenth of its maximum (99.9th percentile)."""
    return response < _VIGNETTED_SHARE * np.percentile(response, 99.9)
