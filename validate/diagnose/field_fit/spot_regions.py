"""Regions of largest excess, and bell-shaped maps that cover them."""

from __future__ import annotations

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label

from .residual_data import ResidualData

__all__ = ["BORDER_OVER_PEAK", "bells_on", "hot_spot", "hot_spot_of_one_band"]

#: Largest part of the image that counts as a spot; larger regions are left to smooth maps.
_MAX_SPOT_PART = 0.15

#: Standard deviation of the Gaussian by which the excess is smoothed, px.
_SMOOTHING_PX = 1.5

#: Numerics: most bells of a spot: limits the time of a fit.
_MAX_BELLS = 200

#: Bells between the middle and the border of a thin region, such as that of a hair: resolves its profile.
_BELLS_ACROSS = 6

#: A spot's peak exceeds the noise of the smoothed excess by this factor.
_MIN_PEAK_OVER_NOISE = 6

#: A spot extends to where the smoothed excess falls to this multiple of its noise.
_BORDER_OVER_NOISE = 4

#: A spot or a line extends at most to where the smoothed excess falls to this part of its peak.
BORDER_OVER_PEAK = 0.05


def hot_spot(data: ResidualData) -> NDArray[np.bool_] | None:
    """Connected region about the largest excess of chi2 over noise, summed over the bands.

    Parameters
    ----------
    data
        Residual.

    Returns
    -------
    NDArray or None
        (y, x) the region; None where none exceeds noise, or the region is too large for a spot.
    """
    over = np.sum(_over_noise(data), axis=0)
    return _about_the_peak(over, np.sqrt(2 * data.used.sum(axis=0).max()))  # behind a mosaic a pixel has few bands


def hot_spot_of_one_band(data: ResidualData) -> NDArray[np.bool_] | None:
    """Connected region about the largest excess of one band over the mean of the other bands.

    Dust or a hair on a filter is visible in one band; an error of all bands elsewhere may be larger.

    Parameters
    ----------
    data
        Residual.

    Returns
    -------
    NDArray or None
        (y, x) the region in the band with the largest excess; None as in ``hot_spot``, and for a single band.
    """
    over, bands = _over_noise(data), len(data.bands)
    if bands < 2:
        return None
    alone = (bands * over - over.sum(axis=0)) / (bands - 1)
    highest = int(np.argmax(gaussian_filter(alone, (0, _SMOOTHING_PX, _SMOOTHING_PX)).max(axis=(1, 2))))
    return _about_the_peak(alone[highest], np.sqrt(2 * bands / (bands - 1)))


def _over_noise(data: ResidualData) -> NDArray[np.float64]:
    """(band, y, x) squares of the residual less their mean by noise."""
    return np.asarray(data.residual.astype(float) ** 2 - data.used)


def _about_the_peak(over: NDArray[np.float64], deviation: float) -> NDArray[np.bool_] | None:
    """Region about the peak of an excess (y, x); None where noise explains the peak.

    ``deviation`` is the standard deviation of a pixel by noise.
    """
    smooth = gaussian_filter(over, _SMOOTHING_PX)
    noise = deviation / (2 * np.sqrt(np.pi) * _SMOOTHING_PX)
    peak = float(smooth.max())
    if peak < _MIN_PEAK_OVER_NOISE * noise:
        return None
    parts, _ = label(smooth > max(_BORDER_OVER_NOISE * noise, BORDER_OVER_PEAK * peak))
    region = parts == parts[np.unravel_index(np.argmax(smooth), smooth.shape)]
    region = binary_dilation(region, iterations=2)
    return region if region.mean() <= _MAX_SPOT_PART else None


def bells_on(region: NDArray[np.bool_], cell: tuple[int, int] | None) -> ImageMaps:
    """Bell-shaped maps that cover a region, at least 1 px or a mosaic's repeat apart.

    Behind a mosaic one frame shows a place in one band alone. So no other band confirms what a single pixel shows, and
    the pixels in the next repeats must.

    Parameters
    ----------
    region
        (y, x) the region.
    cell
        Rows and columns of one repeat of the sensor's mosaic, px; None without a mosaic.

    Returns
    -------
    ImageMaps
        Bells at the smallest pitch that their largest number allows, or at that of a thin region; one or more.
    """
    thin = distance_transform_edt(region).max() / _BELLS_ACROSS
    least = 1.0 if cell is None else float(max(cell))
    pitch = max(least, min(float(np.sqrt(region.sum() / _MAX_BELLS)), float(thin)))
    rows, columns = np.nonzero(region)
    centres = tuple(
        (float(u), float(v))
        for v in np.arange(rows.min(), rows.max() + pitch, pitch)
        for u in np.arange(columns.min(), columns.max() + pitch, pitch)
        if region[min(int(v), region.shape[0] - 1), min(int(u), region.shape[1] - 1)]
    )
    if not centres:  # a region of few pixels may lie between those of the grid
        centres = ((float(columns[0]), float(rows[0])),)
    return ImageMaps("bells", centres=centres, pitch=pitch)
