"""Defective pixels in darks, flats and residuals, by thresholds of stated false-alarm rate."""

from __future__ import annotations

import itertools

import numpy as np
from cboxlab.utils.distributions import normal_quantile, robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import median_filter

__all__ = ["FALSE_ALARMS_PER_IMAGE", "dead_pixels", "hot_pixels", "lone_bright_pixels", "vignetted_pixels"]

#: Mean number of sound pixels flagged in an image by each test, if sound pixels are normally distributed.
FALSE_ALARMS_PER_IMAGE = 0.01

#: Share of the flat's maximum below which a pixel is vignetted.
_VIGNETTED_SHARE = 0.1
#: 5 x 5 pixels without the pixel itself: it would often be the median, and the spread would be underestimated.
_NEIGHBOURS = np.ones((5, 5), bool)
_NEIGHBOURS[2, 2] = False
#: Standard deviations by which a residual exceeds those of its neighbours in a hot pixel: chance gives 2e-6.
_LONE_SIGMAS = 5.0
#: Largest excess of a neighbour over that of a hot pixel: stains and shifted edges reach further.
_LONE_SHARE = 0.5
#: Fewest neighbours of the eight that have a residual.
_FEWEST_NEIGHBOURS = 5


def _robust(
    values: NDArray[np.float64], smallest_sigma: float, pixels: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Deviations from the median of some pixels, in their robust standard deviations."""
    usual = values if pixels is None else values[pixels]
    middle = np.median(usual)
    sigma = max(robust_sigma(usual - middle), smallest_sigma)
    return (values - middle) / sigma


def hot_pixels(dark: NDArray[np.float64], smallest_sigma_dn: float) -> NDArray[np.bool_]:
    """Pixels whose dark level is unusually high (threshold: FALSE_ALARMS_PER_IMAGE).

    The standard deviation is estimated from the median absolute deviation.

    Parameters
    ----------
    dark
        (y, x) dark level, DN.
    smallest_sigma_dn
        Lower bound of the standard deviation, DN: the noise, for frames whose median deviation rounds to 0.

    Returns
    -------
    NDArray
        (y, x) True for hot pixels.
    """
    return _robust(dark, smallest_sigma_dn) > normal_quantile(FALSE_ALARMS_PER_IMAGE / dark.size)


def lone_bright_pixels(pull: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pixels brighter than a rendering whose neighbours are not: hot ones without darks.

    Parameters
    ----------
    pull
        (y, x) measured minus rendered in standard deviations; NaN where unused.

    Returns
    -------
    NDArray
        (y, x) True for such pixels.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(pull, 1, constant_values=np.nan), (3, 3))
    around = np.delete(windows.reshape(*pull.shape, 9), 4, axis=-1)
    usable = np.isfinite(pull) & (np.isfinite(around).sum(axis=-1) >= _FEWEST_NEIGHBOURS)
    lone = np.zeros(pull.shape, bool)
    middle = np.nanmedian(around[usable], axis=-1)
    excess, next_excess = pull[usable] - middle, np.nanmax(around[usable], axis=-1) - middle
    lone[usable] = (excess > _LONE_SIGMAS) & (next_excess < _LONE_SHARE * excess)
    return lone


def dead_pixels(
    response: NDArray[np.float64], cell: tuple[int, int] = (1, 1), channel: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Pixels whose flat response is unusually low compared with their 5 x 5 neighbours.

    The ratio to the neighbours' median is tested against the median absolute deviation of this ratio. Threshold:
    FALSE_ALARMS_PER_IMAGE.

    Parameters
    ----------
    response
        (y, x) relative response.
    cell
        (height, width) of the mosaic's repeat, px: only pixels of the same position in it are compared.
    channel
        (y, x) True for the pixels of the band's channel: the others have another noise. None without a mosaic.

    Returns
    -------
    NDArray
        (y, x) True for dead pixels; False in other channels.
    """
    ratio = np.empty_like(response)
    for row, column in itertools.product(range(cell[0]), range(cell[1])):
        plane = response[row :: cell[0], column :: cell[1]]
        # Odd reflection continues the gradient of the light beyond the edge; even reflection would reverse it.
        padded = np.pad(plane, 2, mode="reflect", reflect_type="odd")
        middle = median_filter(padded, footprint=_NEIGHBOURS)[2:-2, 2:-2]
        ratio[row :: cell[0], column :: cell[1]] = plane / np.maximum(middle, 1e-6)
    if channel is None:
        return _robust(ratio, 1e-6) < -normal_quantile(FALSE_ALARMS_PER_IMAGE / response.size)
    return channel & (_robust(ratio, 1e-6, channel) < -normal_quantile(FALSE_ALARMS_PER_IMAGE / channel.sum()))


def vignetted_pixels(response: NDArray[np.float64], channel: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Pixels in which the flat is below a tenth of its maximum.

    Parameters
    ----------
    response
        (y, x) relative response.
    channel
        (y, x) True for the pixels of the band's channel: another may be ten times as bright. None without a mosaic.

    Returns
    -------
    NDArray
        (y, x) True for vignetted pixels, with a mosaic of the channel; the maximum is the 99.9th percentile.
    """
    if channel is None:
        return response < _VIGNETTED_SHARE * np.percentile(response, 99.9)
    return channel & (response < _VIGNETTED_SHARE * np.percentile(response[channel], 99.9))
