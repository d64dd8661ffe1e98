"""Calibrated constants of a capture between light and counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import (
    BandTable,
    Capture,
    FlatTable,
    ReferenceTable,
    channel_mask,
    shares_frames,
)
from cboxlab.calibration.instrument import Mask
from cboxlab.calibration.radiometry import capture_factors, optical_factor, response_curve
from cboxlab.calibration.result import Calibration
from cboxlab.rendering.chain import Interleaving, MergedExposure, Sensing, UnseenChannel, over_field
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["minutes_of_bands", "sensing"]


def minutes_of_bands(capture: Capture, channels: Mapping[str, str] | None = None) -> NDArray[np.float64]:
    """Times of the bands after the start of the capture.

    A band without ``start_s`` follows the one before it at once. Channels of the same frames have the same time.

    Parameters
    ----------
    capture
        The capture, with exposure times and number of frames.
    channels
        By band, the channel of a sensor with a mosaic; None without one.

    Returns
    -------
    NDArray
        (band,) minutes to the middle of each band's frames.
    """
    readout, free = capture.manifest.camera.readout_s, 0.0
    middles: list[float] = []
    bands = capture.manifest.band
    for index, band in enumerate(bands):
        same = (k for k in range(index) if shares_frames(capture, channels, bands[k].id, band.id))
        if (first := next(same, None)) is not None:
            middles.append(middles[first])
            continue
        start = free if band.start_s is None else band.start_s
        period = band.exposure_s + readout
        middles.append(start + (len(band.frames) - 1) / 2 * period + band.exposure_s / 2)
        free = start + len(band.frames) * period
    return np.array(middles) / 60.0


@dataclass(frozen=True, eq=False)
class _Band:
    """Uniform sources of one band."""

    #: Flat field; None without one.
    flat: FlatTable | None
    #: Reference frames of the radiometric constant; None where they took no part in it.
    reference: ReferenceTable | None
    #: Weight of the band in the radiometric constant.
    weight: float
    #: Spectrum of the flat's source on WAVELENGTH_NM; that of the reference, or ones, where not stated.
    flat_radiance: NDArray[np.float64]
    #: Spectrum of the reference on WAVELENGTH_NM; ones where not stated.
    reference_radiance: NDArray[np.float64]


def _sources(calibration: Calibration, band: str) -> _Band:
    """The uniform sources of a band; the first table counts where there are several."""
    capture = calibration.capture
    flat = next(iter(capture.flats(band)), None)
    radiometry = calibration.radiometry
    measured = [w for c, w in zip(radiometry.by_band, radiometry.weights, strict=True) if c.band == band]
    reference = next(iter(capture.references(band)), None) if measured else None
    source = next((table.radiance for table in capture.references(band)), None)
    spectrum = np.ones_like(WAVELENGTH_NM) if source is None else capture.light(source).at(WAVELENGTH_NM)
    uniform = spectrum if flat is None or flat.radiance is None else capture.light(flat.radiance).at(WAVELENGTH_NM)
    return _Band(flat, reference, float(sum(measured)), uniform, spectrum)


def _interleaving(calibration: Calibration, sources: Sequence[_Band]) -> Interleaving | None:
    """Channels of the pixels in each band's frames; None without a mosaic."""
    capture, mosaic, channels = calibration.capture, calibration.capture.manifest.mosaic, calibration.channels
    if channels is None or mosaic is None:
        return None
    bands = capture.manifest.band
    frames: dict[tuple[str, ...], list[int]] = {}
    for index, band in enumerate(bands):
        frames.setdefault(tuple(band.frames), []).append(index)
    pixels = np.stack([channel_mask(mosaic.pattern, capture.shape, channels[band.id]) for band in bands])
    unseen = []
    for group in frames.values():
        rest = ~pixels[group].any(axis=0)
        for letter in dict.fromkeys(mosaic.pattern.replace(" ", "")):
            of_channel = channel_mask(mosaic.pattern, capture.shape, letter) & rest
            if of_channel.any():
                factor = _channel_ratio(calibration, bands[group[0]], letter, sources[group[0]])
                unseen.append(UnseenChannel(group[0], of_channel, factor))
    return Interleaving(pixels, tuple(tuple(group) for group in frames.values()), tuple(unseen))


def _channel_ratio(calibration: Calibration, band: BandTable, letter: str, source: _Band) -> float:
    """Signal of a channel over that of the band's channel.

    The light is the lamp's, or else that of the flat's source.
    """
    capture, channels = calibration.capture, calibration.channels
    lamp = capture.manifest.lamp
    light = source.flat_radiance if lamp is None else capture.light(lamp.radiance).at(WAVELENGTH_NM)
    other, of_band = (
        response_curve(capture, band, channel) for channel in (letter, channels[band.id] if channels else None)
    )
    if other is None or of_band is None or float(of_band @ light) <= 0:
        return 1.0
    return float(other @ light) / float(of_band @ light)


def _merged(
    calibration: Calibration, sound: NDArray[np.bool_], minutes: NDArray[np.float64]
) -> tuple[MergedExposure, ...]:
    """The exposures that were merged, the bands' own first.

    Bands with fewer exposures have weight 0 in the others. sound : (band, y, x) pixels that give the dark level.
    minutes : (band,) those of the bands' own frames.
    """
    capture, merged = calibration.capture, calibration.bands.merged
    ids, readout = capture.band_ids, capture.manifest.camera.readout_s
    exposures = []
    for index in range(max((len(each.tables) for each in merged.values()), default=0)):
        ratio, weight = np.ones(len(ids)), np.zeros((len(ids), *capture.shape))
        dark, middle = np.zeros(len(ids)), minutes.copy()
        for number, band in enumerate(ids):
            tables = merged[band].tables if band in merged else (capture.band(band),)
            if index >= len(tables):
                continue
            table = tables[index]
            weight[number] = merged[band].weights[index] if band in merged else 1.0
            ratio[number] = merged[band].ratios[index] if band in merged else 1.0
            if sound[number].any():
                dark[number] = float(calibration.dark.at(table.exposure_s)[sound[number]].mean())
            if index and table.start_s is not None:
                seconds = table.exposure_s / 2 + (len(table.frames) - 1) / 2 * (table.exposure_s + readout)
                middle[number] = (table.start_s + seconds) / 60.0
        exposures.append(MergedExposure(ratio, weight, dark, middle))
    return tuple(exposures)


def sensing(calibration: Calibration, camera: Camera) -> Sensing:
    """Constants of the sensor equation of a capture.

    Parameters
    ----------
    calibration
        Calibration of the capture.
    camera
        Camera, for the range of field angles.

    Returns
    -------
    Sensing
        Response curves, flats, references, dark levels, exposures and times by band.

    Raises
    ------
    InputError
        If the capture has neither reference frames nor the data for the constant C.
    """
    capture, radiometry = calibration.capture, calibration.radiometry
    constant, of_bands = radiometry.constant, radiometry.band_constants
    if constant is None or of_bands is None:
        fault = "neither usable reference frames nor focal length, pixel pitch and gain"
        raise InputError(capture.folder / "capture.toml", fault, "one of them, for the constant C")
    bands = calibration.bands
    unusable = Mask.HOT | Mask.DEAD | Mask.VIGNETTED
    mask = bands.images["mask"].values
    flats = [bands.flats[band] for band in capture.band_ids]
    sources = [_sources(calibration, band) for band in capture.band_ids]
    mosaic = _interleaving(calibration, sources)
    usable = ~np.stack([flat.saturated for flat in flats])
    if mosaic is not None:
        usable &= mosaic.pixels
    exposures = {
        "scene": np.array([band.exposure_s for band in capture.manifest.band]),
        "flat": np.array([s.flat.exposure_s if s.flat else 1.0 for s in sources]),
        "reference": np.array([s.reference.exposure_s if s.reference else 1.0 for s in sources]),
    }
    sound = (mask & unusable) == 0

    def dark(of: str) -> NDArray[np.float64]:
        levels = zip(exposures[of], sound, strict=True)
        return np.array([float(calibration.dark.at(t)[s].mean()) if s.any() else 0.0 for t, s in levels])

    minutes = minutes_of_bands(capture, calibration.channels)
    factors = [0.0 if s.reference is None else optical_factor(capture, s.reference) or 0.0 for s in sources]
    return Sensing(
        curves=over_field(capture_factors(capture, of_bands, calibration.channels, FILTER_GRID), camera),
        flat_radiance=np.stack([s.flat_radiance for s in sources]),
        reference_radiance=np.stack([s.reference_radiance for s in sources]),
        flat=np.stack([flat.response for flat in flats]),
        usable=usable,
        good=usable & sound,
        flat_level=np.array([flat.mean_dn if np.isfinite(flat.mean_dn) else 0.0 for flat in flats]),
        reference_factor=constant * np.array(factors),
        reference_weight=np.array([s.weight for s in sources]),
        dark_scene=dark("scene"),
        dark_flat=dark("flat"),
        dark_reference=dark("reference"),
        exposure_scene=exposures["scene"],
        exposure_flat=exposures["flat"],
        exposure_reference=exposures["reference"],
        minutes=minutes,
        full_scale=float(capture.full_scale_dn),
        mosaic=mosaic,
        merged=_merged(calibration, sound, minutes),
    )
