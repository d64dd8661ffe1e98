"""Reflectances of labelled patches, measured relative to the white patch.

For each band: take the pixels of the filter's channel; add the black level measured from the brackets to the corrected
frames; divide by the illumination (see ``shading``); average over each patch without its rim; scale to the tabulated
band reflectance of the white patch.

Stray light adds nearly the same signal to all patches and matters most in the darkest. The darkest patch is therefore
assumed to be spectrally neutral, as the black patch of a chart is designed to be. Its reflectance is its median over
the bands; the difference in each band is subtracted as an offset. No other tabulated reflectance is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM, WavelengthGrid
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from ..capture import Capture, Label, channel_mask
from ..correction import CorrectedBands, NoiseModel
from ..detector import Linearity
from ..instrument import Mask
from ..radiometry import response_curve
from .chart import find_chart
from .joined_channels import BandColumns, joined_channels
from .shading import PatchPixels, Shading, fit_shading

__all__ = ["PatchTable", "band_filter", "measure_patches", "patch_levels", "patch_pixels", "white_patch"]

#: Wavelength range in which reflectances of charts are tabulated.
_GRID = FILTER_GRID.between(380.0, 730.0)
#: Width of the rim of a patch that is not used, px.
_RIM_PX = 4
#: Distance from the peak of a filter, nm, beyond which its transmittance counts as leakage.
_HALF_WIDTH_NM = 15.0
#: Number of the white patch of a ColorChecker.
_WHITE_LABEL = 19
#: In frames reduced in size, counts above this share of the largest may be means that include clipped pixels.
_HIGHEST_SHARE = 0.98
#: Fewest usable pixels of a patch.
_FEWEST_PIXELS = 20


@dataclass(frozen=True, eq=False)
class PatchTable(FrozenMappings):
    """Measured patches of a chart."""

    #: n patches.
    labels: tuple[Label, ...]
    #: m identifiers of bands.
    bands: tuple[str, ...]
    #: (n, m) band reflectances.
    reflectance: NDArray[np.float64]
    #: (n, m) standard deviations, by noise, shading and the offset, without the error of the white patch's table.
    sigma: NDArray[np.float64]
    #: (m,) reflectance that was subtracted.
    offset: NDArray[np.float64]
    #: Illumination by band, where it could be fitted.
    shading: Mapping[str, Shading]
    #: Wavelengths of `filters`.
    grid: WavelengthGrid
    #: (m, wavelength) weights of unit sum: filter times sensor, lens and lamp if the capture states all of them, else
    #: the filter within 15 nm of its peak.
    filters: NDArray[np.float64]
    #: White patch.
    white: Label
    #: Bands without shading, and the offsets.
    notes: tuple[str, ...]


def band_filter(transmittance: Spectrum, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transmittance within 15 nm of its highest peak, 0 elsewhere, scaled to unit sum.

    Parameters
    ----------
    transmittance
        Transmittance of a filter.
    wavelength_nm
        (n,) grid of wavelengths, nm.

    Returns
    -------
    NDArray
        (n,) weights of unit sum.
    """
    values = transmittance.at(wavelength_nm)
    peak = wavelength_nm[np.argmax(values)]
    values = np.where(np.abs(wavelength_nm - peak) <= _HALF_WIDTH_NM, values, 0.0)
    return values / values.sum()


def _spectral_weights(
    capture: Capture, bands: CorrectedBands, index: int, wavelength_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) spectral weights of a band's reflectance, of unit sum.

    Filter times sensor, lens and lamp if the capture states them all, else ``band_filter``.
    """
    band, lamp = capture.manifest.band[index], capture.manifest.lamp
    channel = None if capture.manifest.mosaic is None else str(bands.images["channel"].values[index])
    curve = response_curve(capture, band, channel)
    if curve is None or lamp is None or not np.any(curve):
        return band_filter(capture.light(str(band.transmittance)), wavelength_nm)
    product = Spectrum(WAVELENGTH_NM, curve * capture.light(lamp.radiance).at(WAVELENGTH_NM), "zero")
    values = product.at(wavelength_nm)
    return values / values.sum()


def _has_weights(capture: Capture, bands: CorrectedBands, index: int) -> bool:
    """Whether a band has a filter, or else a stated response and a lamp."""
    band = capture.manifest.band[index]
    if band.transmittance is not None:
        return True
    channel = None if capture.manifest.mosaic is None else str(bands.images["channel"].values[index])
    curve = response_curve(capture, band, channel)
    return curve is not None and bool(np.any(curve)) and capture.manifest.lamp is not None


def white_patch(capture: Capture, labels: Sequence[Label]) -> Label | None:
    """White patch of a chart.

    Parameters
    ----------
    capture
        Capture with [labels].
    labels
        The capture's labels.

    Returns
    -------
    Label | None
        Number 19, or one named white, with a tabulated reflectance; None without one.
    """
    reflectances = capture.label_reflectances()
    usable = [label for label in labels if label.column in reflectances]
    whites = [label for label in usable if "white" in label.name.lower()]
    return next((label for label in (*usable,) if label.label == _WHITE_LABEL), whites[0] if whites else None)


def patch_pixels(
    capture: Capture,
    bands: CorrectedBands,
    noise: NoiseModel,
    index: int,
    black_dn: float,
    labels: Sequence[Label],
    image: NDArray[np.uint8],
) -> list[PatchPixels | None]:
    """Usable pixels of each patch in one band, without its rim.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands.
    noise
        The capture's noise model.
    index
        Position of the band.
    black_dn
        Black level that the correction left, DN.
    labels
        Labels of the patches.
    image
        (y, x) label of each pixel.

    Returns
    -------
    list
        One for each label; None for a patch with too few pixels.
    """
    manifest = capture.manifest
    band = manifest.band[index]
    usable = bands.images["mask"].values[index] & np.uint8(Mask.SATURATED | Mask.HOT | Mask.DEAD) == 0
    usable &= capture.frames(band).max(axis=0) < _HIGHEST_SHARE * capture.saturation_dn
    if manifest.mosaic is not None:
        channel = str(bands.images["channel"].values[index])
        usable &= channel_mask(manifest.mosaic.pattern, capture.shape, channel)
    signal = bands.images["signal"].values[index] + black_dn / bands.flats[band.id].response
    patches: list[PatchPixels | None] = []
    for label in labels:
        v, u = np.nonzero(binary_erosion(image == label.label, iterations=_RIM_PX) & usable)
        if u.size < _FEWEST_PIXELS:
            patches.append(None)
            continue
        values = signal[v, u]
        response = float(bands.flats[band.id].response[v, u].mean())
        variance = float(noise.variance(values.mean() * response)) / len(band.frames) / response**2
        patches.append(PatchPixels(u.astype(float), v.astype(float), values, float(np.sqrt(variance))))
    return patches


def _relative_signals(
    patches: Sequence[PatchPixels | None], shading: Shading | None, white: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """(n,) signals over the white one without shading, their sigmas, and the white signal, DN.

    NaN where the white patch has no light, as where it has no pixels: no ratio to it is a reflectance.
    """
    level, sigma = patch_levels(patches, shading, white)
    if not level[white] > 0:
        return np.full(len(patches), np.nan), np.full(len(patches), np.nan), float("nan")
    relative_white = sigma[white] / level[white]
    ratio = level / level[white]
    spread = np.hypot(sigma / level[white], ratio * relative_white)
    spread[white] = relative_white
    return ratio, spread, float(level[white])


def patch_levels(
    patches: Sequence[PatchPixels | None], shading: Shading | None, white: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signals of patches as if they stood where the shading is 1.

    Parameters
    ----------
    patches
        Usable pixels of n patches.
    shading
        Illumination of the chart; None for a uniform one.
    white
        Position of the white patch.

    Returns
    -------
    NDArray
        (n,) signals, DN; NaN for patches without pixels, and for all without a white one.
    NDArray
        (n,) standard deviations, DN, with those of the shading relative to the white patch.
    """
    level, sigma = np.full(len(patches), np.nan), np.full(len(patches), np.nan)
    reference = patches[white]
    if reference is None:
        return level, sigma
    position = (float(reference.u_px.mean()), float(reference.v_px.mean()))
    for index, patch in enumerate(patches):
        if patch is None:
            continue
        light = np.ones(patch.signal.size) if shading is None else shading.at(patch.u_px, patch.v_px)
        # A ratio of sums is weighted by the light and avoids the bias of a mean of noisy ratios.
        level[index] = patch.signal.sum() / light.sum()
        uneven = 0.0
        if shading is not None:
            uneven = float(shading.relative_sigma(patch.u_px.mean(), patch.v_px.mean(), position))
        noise = patch.sigma * np.sqrt(patch.signal.size) / light.sum()
        sigma[index] = np.hypot(noise, level[index] * uneven)
    return level, sigma


def _subtract_offsets(
    reflectance: NDArray[np.float64], sigma: NDArray[np.float64], white: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Two-point scale: the white patch as tabulated (m,), the darkest patch neutral.

    The result is the corrected reflectances and sigmas (n, m), the offsets (m,) and the index of the darkest patch.
    With an offset o in units of reflectance, the white-scaled value is q = (rho + o) w / (w + o). The variance of an
    offset is that of the darkest patch plus the excess scatter over its bands, since the patch may not be neutral.
    """
    darkest = int(np.nanargmin(np.median(reflectance, axis=1)))
    dark = reflectance[darkest]
    neutral = float(np.median(dark))
    offset = white * (dark - neutral) / (white - dark)
    corrected = reflectance * (white + offset) / white - offset
    dark_sigma = sigma[darkest]
    beyond = max(float(np.sum((dark - dark.mean()) ** 2) / (dark.size - 1) - np.mean(dark_sigma**2)), 0.0)
    # The variance of the median of n normal values is pi / 2 times that of their mean.
    level = 1.5708 / dark.size * (np.mean(dark_sigma**2) + beyond)
    spread = np.sqrt(dark_sigma**2 + beyond + level) * np.abs(1 - reflectance / white)
    corrected_sigma = np.hypot(sigma, spread)
    # The darkest patch is set to the same value in all bands.
    corrected_sigma[darkest] = np.sqrt(level + beyond)
    return corrected, corrected_sigma, offset, darkest


def measure_patches(
    capture: Capture, bands: CorrectedBands, noise: NoiseModel, linearity: Linearity | None
) -> PatchTable | None:
    """Band reflectances of all labelled patches.

    Parameters
    ----------
    capture
        Capture with or without `[labels]`.
    bands
        The capture's corrected bands.
    noise
        The capture's noise model.
    linearity
        Linearity with the black level of the brackets; None assumes a black level of 0.

    Returns
    -------
    PatchTable | None
        Measured patches; None without labels, filter transmittances or a white patch.

    Raises
    ------
    InputError
        For faulty files, and if [labels] states no image and no chart is found.
    """
    if capture.manifest.labels is None:
        return None
    labels = tuple(label for label in capture.label_names() if not label.excludes)
    white = white_patch(capture, labels)
    if white is None or not all(_has_weights(capture, bands, index) for index in range(len(capture.band_ids))):
        return None
    image = capture.labels() if capture.manifest.labels.image is not None else find_chart(capture, bands)
    count = len(capture.band_ids)
    filters = np.stack([_spectral_weights(capture, bands, index, _GRID.nm) for index in range(count)])
    white_reflectance = filters @ capture.label_reflectances()[str(white.column)].at(_GRID.nm)
    black = 0.0 if linearity is None else linearity.black_level_dn
    position = labels.index(white)
    columns, spreads, levels, shadings, notes = [], [], [], {}, []
    for index, identifier in enumerate(capture.band_ids):
        patches = patch_pixels(capture, bands, noise, index, black, labels, image)
        shading = fit_shading([patch for patch in patches if patch is not None])
        if shading is None:
            notes.append(f"{identifier}: too few bright patches; uniform illumination was assumed")
        else:
            shadings[identifier] = shading
        ratio, spread, level = _relative_signals(patches, shading, position)
        levels.append(level)
        columns.append(ratio * white_reflectance[index])
        spreads.append(spread * white_reflectance[index])
    reflectance, sigma = np.stack(columns, axis=1), np.stack(spreads, axis=1)
    of_bands = BandColumns(capture.band_ids, reflectance, sigma, filters, white_reflectance, np.array(levels))
    joined = joined_channels(capture, of_bands)
    names, reflectance, sigma = joined.bands, joined.reflectance, joined.sigma
    filters, white_reflectance = joined.filters, joined.white
    notes += joined.notes
    offset = np.zeros(len(names))
    if len(names) >= 3 and np.all(np.isfinite(reflectance)):
        reflectance, sigma, offset, darkest = _subtract_offsets(reflectance, sigma, white_reflectance)
        offsets_text = ", ".join(f"{b} {o:+.3f}" for b, o in zip(names, offset, strict=True))
        notes.append(
            f"patches: '{labels[darkest].name}' was assumed spectrally neutral; offsets subtracted "
            f"(above 0: stray light; below 0: unexplained): {offsets_text}"
        )
    return PatchTable(
        labels,
        names,
        reflectance,
        sigma,
        offset,
        shadings,
        _GRID,
        filters,
        white,
        tuple(notes),
    )
