"""Sensor parameters by EMVA 1288, in its symbols: K, sigma_d, DSNU, PRNU, saturation.

Temporal noise comes from differences between repeats, spatial patterns from means of repeats. With mu_y a mean
count and sigma_y^2 its temporal variance, photon transfer is the straight line

    sigma_y^2 - sigma_y.dark^2 = K (mu_y - mu_y.dark),    sigma_y.dark^2 = (K sigma_d)^2 + 1/12,

and the nonuniformities are DSNU = s_y.dark / K and PRNU = sqrt(s_y^2 - s_y.dark^2) / (mu_y - mu_y.dark). The
spatial variances s^2 are corrected for the temporal noise that remains in the means. A polynomial of fourth order
removes the flat field's gradients from s_y^2; the standard requires uniform light instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray

from ..capture import Capture, FrameTable, channel_mask
from ..correction import ROUNDING_VARIANCE, DarkLibrary, hot_pixels, with_steady_light

__all__ = ["FrameStatistics", "PhotonTransfer", "frame_statistics", "measure_photon_transfer", "transfer"]

#: Share of saturation up to which K is fitted (EMVA 1288, release 4.0, section 6.6).
_FITTED_SHARE = 0.7
#: Standard deviations from the mean beyond which a pixel is a defect and is left out.
_OUTLIER_SIGMAS = 6.0
#: Order of the polynomial that describes the gradients of a flat field.
_GRADIENT_ORDER = 4
#: Share of the largest variance below which, if significant, a level is beyond saturation.
_MAX_SATURATED_VARIANCE_SHARE = 0.95
#: Share of clipped pixels in a level used for the fit, at most: hot pixels may clip in any frame.
_MAX_CLIPPED_SHARE = 1e-3


@dataclass(frozen=True)
class FrameStatistics:
    """Mean, temporal and spatial variance of repeats of one setting."""

    #: mu_y, mean count, DN.
    mean: float
    #: sigma_y^2, temporal variance of one frame, DN^2.
    temporal: float
    #: Its standard deviation, DN^2.
    temporal_sigma: float
    #: s_y^2, variance of the pixels' means, DN^2; it can be negative by noise.
    spatial: float
    #: Its standard deviation, DN^2.
    spatial_sigma: float
    #: Share of pixels at the largest count, 0 to 1.
    clipped: float


@dataclass(frozen=True)
class PhotonTransfer:
    """Sensor parameters by photon transfer. A sigma is one standard deviation.

    NaN where a value cannot be determined: a spatial variance below 0, a read noise below rounding.
    """

    #: K, DN/e-.
    gain_dn_per_e: float
    #: Standard deviation of K, DN/e-.
    gain_sigma: float
    #: sigma_d, noise without light, e-.
    dark_noise_e: float
    #: Its standard deviation, e-.
    dark_noise_sigma: float
    #: Dark signal nonuniformity, e-.
    dsnu_e: float
    #: Its standard deviation, e-.
    dsnu_sigma: float
    #: Photoresponse nonuniformity, relative.
    prnu: float
    #: Its standard deviation, relative.
    prnu_sigma: float
    #: Electrons of a full pixel, or at the largest temporal variance; None if no level lies beyond it.
    saturation_e: float | None
    #: Electrons at the largest count, above the dark level.
    converter_limit_e: float


def _smooth_part(mean: NDArray[np.float64], good: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(y, x) polynomial of order ``_GRADIENT_ORDER`` through the good pixels of a mean image."""
    v, u = np.indices(mean.shape)
    x, y = 2 * u / max(mean.shape[1] - 1, 1) - 1, 2 * v / max(mean.shape[0] - 1, 1) - 1
    basis = np.stack([x**j * y**k for j in range(_GRADIENT_ORDER + 1) for k in range(_GRADIENT_ORDER + 1 - j)], axis=-1)
    fit = np.linalg.lstsq(basis[good], mean[good], rcond=None)[0]
    return np.asarray(basis @ fit, np.float64)


def frame_statistics(
    stack: NDArray[np.uint16], saturation_dn: int, *, flatten: bool, pixels: NDArray[np.bool_] | None = None
) -> FrameStatistics:
    """Statistics of repeats of one setting.

    Parameters
    ----------
    stack
        (repeat, y, x) counts of at least two repeats, DN.
    saturation_dn
        The count from which a pixel is saturated, DN.
    flatten
        True to remove smooth gradients of the field from the spatial variance.
    pixels
        (y, x) True for pixels used; all where left out. Outliers of the spatial pattern are left out in any case.

    Returns
    -------
    FrameStatistics
        Changes of the light between repeats are removed before the temporal variance is taken.

    Raises
    ------
    ValueError
        For fewer than two repeats.
    """
    if stack.shape[0] < 2:
        raise ValueError("temporal noise needs at least two repeats")
    counts = stack.astype(float)
    good = np.ones(stack.shape[1:], bool) if pixels is None else pixels.copy()
    clipped = float((stack.max(axis=0) >= saturation_dn)[good].mean())
    mean = counts.mean(axis=0)
    residual = mean - (_smooth_part(mean, good) if flatten else mean[good].mean())
    middle = np.median(residual[good])
    spread = robust_sigma(residual[good] - middle)
    good &= np.abs(residual - middle) <= _OUTLIER_SIGMAS * max(spread, np.sqrt(ROUNDING_VARIANCE))
    weight = np.ones(mean.shape)
    if flatten:
        smooth = _smooth_part(mean, good)
        # Nonuniform sensitivity is relative to the local light.
        weight = float(mean[good].mean()) / np.maximum(smooth, 1.0)
        residual = (mean - smooth) * weight
    pattern_parameters = 1 + (flatten * ((_GRADIENT_ORDER + 1) * (_GRADIENT_ORDER + 2) // 2 - 1))
    count, repeats = int(good.sum()), stack.shape[0]
    pixel_variance = with_steady_light(counts, good).var(axis=0, ddof=1)
    temporal = float(pixel_variance[good].mean())
    spatial_variance = float(np.sum((residual[good] - residual[good].mean()) ** 2) / (count - pattern_parameters))
    return FrameStatistics(
        float(mean[good].mean()),
        temporal,
        temporal * float(np.sqrt(2 / (count * (repeats - 1)))),
        spatial_variance - float((pixel_variance * weight**2)[good].mean()) / repeats,
        float(np.sqrt(2 / count) * np.hypot(spatial_variance, temporal / repeats / np.sqrt(repeats - 1))),
        clipped,
    )


def transfer(dark: FrameStatistics, bright: Sequence[FrameStatistics], saturation_dn: int) -> PhotonTransfer | None:
    """Sensor parameters from one dark and several bright settings.

    Parameters
    ----------
    dark
        Statistics without light.
    bright
        Statistics of bright settings. Repeats without temporal noise are left out: they are copies or clipped.
    saturation_dn
        The largest count, DN.

    Returns
    -------
    PhotonTransfer | None
        None if no bright setting can be used.
    """
    # repeats without any noise are copies of one frame, or clipped
    levels = sorted((b for b in bright if b.mean > dark.mean and b.temporal > 0), key=lambda b: b.mean)
    if not levels:
        return None
    peak = max(levels, key=lambda b: b.temporal)
    saturates = any(
        b.mean > peak.mean
        and b.temporal
        < _MAX_SATURATED_VARIANCE_SHARE * peak.temporal - 5 * np.hypot(b.temporal_sigma, peak.temporal_sigma)
        for b in levels
    )
    full = (peak.mean if saturates else saturation_dn) - dark.mean
    fitted = [b for b in levels if b.mean - dark.mean <= _FITTED_SHARE * full and b.clipped < _MAX_CLIPPED_SHARE]
    if not fitted:
        return None
    x = np.array([b.mean - dark.mean for b in fitted])
    y = np.array([b.temporal - dark.temporal for b in fitted])
    weight = np.array([b.temporal_sigma for b in fitted]) ** -2.0
    gain = float(np.sum(weight * x * y) / np.sum(weight * x**2))
    # The error of the dark variance is common to all differences.
    common = float(np.sum(weight * x) / np.sum(weight * x**2))
    gain_sigma = float(np.sqrt(1 / np.sum(weight * x**2) + (common * dark.temporal_sigma) ** 2))
    read = dark.temporal - ROUNDING_VARIANCE
    noise = float(np.sqrt(read) / gain) if read > 0 else np.nan
    noise_sigma = noise * float(np.hypot(dark.temporal_sigma / (2 * max(read, 1e-12)), gain_sigma / gain))
    dsnu = float(np.sqrt(dark.spatial) / gain) if dark.spatial > 0 else np.nan
    dsnu_sigma = dsnu * float(np.hypot(dark.spatial_sigma / (2 * max(dark.spatial, 1e-12)), gain_sigma / gain))
    middle = min(fitted, key=lambda b: abs(b.mean - dark.mean - full / 2))
    pattern, signal = middle.spatial - dark.spatial, middle.mean - dark.mean
    prnu = float(np.sqrt(pattern) / signal) if pattern > 0 else np.nan
    prnu_sigma = prnu * float(np.hypot(middle.spatial_sigma, dark.spatial_sigma)) / (2 * max(pattern, 1e-12))
    saturation = (peak.mean - dark.mean) / gain if saturates else None
    return PhotonTransfer(
        gain,
        gain_sigma,
        noise,
        noise_sigma,
        dsnu,
        dsnu_sigma,
        prnu,
        prnu_sigma,
        saturation,
        (saturation_dn - dark.mean) / gain,
    )


def measure_photon_transfer(
    capture: Capture, dark: DarkLibrary, channels: dict[str, str] | None = None
) -> PhotonTransfer | None:
    """Sensor parameters from the darks of the shortest exposure and all flats and references.

    Only exposures with repeats are used.

    Parameters
    ----------
    capture
        The capture.
    dark
        The capture's dark levels.
    channels
        With a mosaic, the channel of each band; None without one.

    Returns
    -------
    PhotonTransfer | None
        None without repeated darks, with darks clipped at 0, or without a usable bright exposure.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    darks = sorted((t for t in capture.manifest.darks if len(t.frames) > 1), key=lambda t: t.exposure_s)
    tables: list[FrameTable] = [*capture.manifest.flats, *capture.manifest.reference]
    if not darks or dark.clipped:
        return None
    patterns = {t.exposure_s: frame_statistics(capture.frames(t), capture.saturation_dn, flatten=False) for t in darks}
    first = patterns[darks[0].exposure_s]
    bright = []
    for table in tables:
        if len(table.frames) < 2:
            continue
        pixels = ~hot_pixels(dark.at(table.exposure_s), float(np.sqrt(ROUNDING_VARIANCE)))
        if channels is not None and capture.manifest.mosaic is not None:
            channel = channels[table.band]  # type: ignore[attr-defined]
            pixels &= channel_mask(capture.manifest.mosaic.pattern, capture.shape, channel)
        stack = capture.frames(table)
        # The hot pixels are left out. Thermal charge has the same K, so it needs no subtraction.
        statistics = frame_statistics(stack, capture.saturation_dn, flatten=True, pixels=pixels)
        # The dark pattern grows with exposure time: subtract its growth since the shortest exposure.
        pattern_growth = patterns.get(table.exposure_s, first).spatial - first.spatial
        bright.append(replace(statistics, spatial=statistics.spatial - pattern_growth))
    sensor = transfer(first, bright, capture.full_scale_dn)
    if sensor is None or capture.full_well_dn is None:
        return sensor
    return replace(sensor, saturation_e=(capture.full_well_dn - first.mean) / sensor.gain_dn_per_e)
