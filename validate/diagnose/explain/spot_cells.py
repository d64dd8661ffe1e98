"""Where the excess is densest, and bells that cover it."""

from __future__ import annotations

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label

from .excess import Excess

__all__ = ["cells", "hot_spot", "spot_of_one_band"]

#: A spot that is a larger part of the picture than this is none.
_LARGEST = 0.15

#: Standard deviation over which the excess is smoothed, px.
_SMOOTHED_PX = 1.5

#: Most cells of a spot, and how many lie between the middle and the border of one that is thin, as a hair's.
_MOST_CELLS, _BELLS_ACROSS = 200, 6


def hot_spot(excess: Excess) -> NDArray[np.bool_] | None:
    """(y, x) the connected region about the highest excess of chi2; None where none stands out of noise."""
    over = np.sum(_over_noise(excess), axis=0)
    return _about_the_peak(over, np.sqrt(2 * len(excess.bands)))


def spot_of_one_band(excess: Excess) -> NDArray[np.bool_] | None:
    """The same of one band's excess less the mean of the others', for the band in which it is highest.

    Dust on a filter, or a hair, is in one band; what is wrong in all bands may be larger and elsewhere.
    """
    over, bands = _over_noise(excess), len(excess.bands)
    if bands < 2:
        return None
    alone = (bands * over - over.sum(axis=0)) / (bands - 1)
    highest = int(np.argmax(gaussian_filter(alone, (0, _SMOOTHED_PX, _SMOOTHED_PX)).max(axis=(1, 2))))
    return _about_the_peak(alone[highest], np.sqrt(2 * bands / (bands - 1)))


def _over_noise(excess: Excess) -> NDArray[np.float64]:
    """(band, y, x) squares of the residual less what noise makes of them."""
    return np.asarray(excess.residual.astype(float) ** 2 - excess.used)


def _about_the_peak(over: NDArray[np.float64], deviation: float) -> NDArray[np.bool_] | None:
    """deviation : standard deviation of a pixel of ``over`` (y, x) by noise."""
    smooth = gaussian_filter(over, _SMOOTHED_PX)
    noise = deviation / (2 * np.sqrt(np.pi) * _SMOOTHED_PX)
    peak = float(smooth.max())
    if peak < 6 * noise:
        return None
    parts, _ = label(smooth > max(4 * noise, 0.05 * peak))
    region = parts == parts[np.unravel_index(np.argmax(smooth), smooth.shape)]
    region = binary_dilation(region, iterations=2)
    return region if region.mean() <= _LARGEST else None


def cells(region: NDArray[np.bool_]) -> ImageMaps:
    """Bells over a region, as close as their number allows or as a thin one needs, 1 px at the least."""
    thin = distance_transform_edt(region).max() / _BELLS_ACROSS
    pitch = max(1.0, min(float(np.sqrt(region.sum() / _MOST_CELLS)), float(thin)))
    rows, columns = np.nonzero(region)
    centres = tuple(
        (float(u), float(v))
        for v in np.arange(rows.min(), rows.max() + pitch, pitch)
        for u in np.arange(columns.min(), columns.max() + pitch, pitch)
        if region[min(int(v), region.shape[0] - 1), min(int(u), region.shape[1] - 1)]
    )
    return ImageMaps("bells", centres=centres, pitch=pitch)
