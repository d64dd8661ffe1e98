"""The exposures of a capture as points of response series: the settings and the counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from ..capture import BandTable, BracketTable, Capture, channel_mask
from ..correction import (
    CorrectedBands,
    DarkLibrary,
    NoiseModel,
    correct,
    evaluate_variance,
    uniform_flat,
)
from ..instrument import Mask
from ..radiometry import response_curve
from .nonlinearity import LightSeries
from .response import LAWS, REPEATABILITY, ResponseFit, fit_response

__all__ = ["ResponsePoint", "ResponseSeries", "light_series", "measure_responses", "response_points"]

#: Share of clipped pixels above which a point is left out.
_MAX_CLIPPED_SHARE = 1e-3
#: Share of the field's width and height that is used, in the middle: the sensor equation holds near the axis.
_MIDDLE_SHARE = 0.5
#: Pixels of a point, at least.
_MIN_PIXELS = 16
#: Lowest mean signal of a point, DN: below it rounding and clipping at 0 bias the mean.
_MIN_SIGNAL_DN = 3.0
#: Largest share of saturation: above it single pixels clip.
_MAX_SATURATION_SHARE = 0.92


@dataclass(frozen=True)
class ResponsePoint(FrozenMappings):
    """One exposure of a steady light."""

    #: Identifier of the band.
    band: str
    #: "reference", "flat" or "scene".
    source: str
    #: By key of LAWS, None where not stated. The flux is Int F Q T L dl of the source, proportional to photoelectrons
    #: per second.
    settings: Mapping[str, float | None]
    #: Mean above dark over the middle of the field, flat-corrected, DN.
    signal_dn: float
    #: Its standard deviation by noise, DN.
    sigma_dn: float
    #: Mean count as stored, dark included, DN.
    count_dn: float
    #: Repeats averaged.
    frames: int = 1
    #: Relative standard deviation by the flat, common to all points of one light.
    flat_sigma: float = 0.0


@dataclass(frozen=True, eq=False)
class ResponseSeries:
    """Points of one light in which only one setting was changed, and their fit."""

    #: The setting that was changed, a key of LAWS.
    key: str
    #: Identifier of the band.
    band: str
    #: "reference", "flat" or "scene".
    source: str
    #: The fit of the law to the points.
    fit: ResponseFit


def _middle(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(y, x) True in the middle of the field, see ``_MIDDLE_SHARE``."""
    inside: NDArray[np.bool_] = np.zeros(shape, bool)
    margins = [round(size * (1 - _MIDDLE_SHARE) / 2) for size in shape]
    inside[margins[0] : shape[0] - margins[0], margins[1] : shape[1] - margins[1]] = True
    return inside


def _unclipped(capture: Capture, table: BandTable | BracketTable) -> NDArray[np.bool_]:
    """(y, x) True where a pixel and its neighbours are well below saturation in all repeats."""
    brightest = maximum_filter(capture.frames(table).max(axis=0), 3)
    return np.asarray(brightest < _MAX_SATURATION_SHARE * capture.saturation_dn, np.bool_)


def _flux(capture: Capture, table: BandTable | BracketTable, channel: str | None) -> float | None:
    """Photoelectrons per second of a source, up to a constant; None if not stated."""
    radiance = getattr(table, "radiance", None)
    curve = response_curve(capture, capture.band(table.band), channel) if radiance else None  # type: ignore[union-attr]
    if curve is None:
        return None
    light = capture.light(str(radiance)).at(WAVELENGTH_NM)
    return float(np.sum(INTEGRAL_GRID.weights * curve * light))


def response_points(
    capture: Capture,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None = None,
) -> tuple[ResponsePoint, ...]:
    """Points of all references, of all flats with a stated radiance, and of the scene.

    The scene is used where a band has three exposures or more. Points with clipped pixels are left out. The scene's
    points are means over the pixels that are not clipped in any of its exposures used.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands, for flats and masks.
    dark
        The capture's dark levels.
    noise
        Noise model of one count.
    channels
        With a mosaic, the channel of each band; None without one.

    Returns
    -------
    tuple
        The points, by band and source.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    points: list[ResponsePoint] = []
    for band in capture.manifest.band:
        scene: list[BandTable | BracketTable] = [band, *capture.brackets(band.id)]
        groups: list[tuple[str, list[BandTable | BracketTable]]] = [
            ("reference", list(capture.references(band.id))),
            ("flat", [flat for flat in capture.flats(band.id) if flat.radiance is not None]),
            ("scene", scene if len(scene) > 2 else []),
        ]
        channel = None if channels is None else channels[band.id]
        usable = _middle(capture.shape)
        unusable = Mask.HOT | Mask.DEAD | Mask.VIGNETTED
        usable &= bands.images["mask"].sel(band=band.id).values & unusable == 0
        if channel is not None and capture.manifest.mosaic is not None:
            usable &= channel_mask(capture.manifest.mosaic.pattern, capture.shape, channel)
        for source, tables in groups:
            points += _points(
                capture, source, tables, usable=usable, bands=bands, dark=dark, noise=noise, channel=channel
            )
    return tuple(points)


def _points(
    capture: Capture,
    source: str,
    tables: list[BandTable | BracketTable],
    *,
    usable: NDArray[np.bool_],
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channel: str | None,
) -> list[ResponsePoint]:
    """Points of the tables of one band and source."""
    if not tables:
        return []
    band = tables[0].id if isinstance(tables[0], BandTable) else tables[0].band
    flat = uniform_flat(capture.shape, dark) if source == "flat" else bands.flats[band]
    frames = [correct(capture, table, uniform_flat(capture.shape, dark), dark, noise) for table in tables]
    if source == "scene":
        # Keep the exposures in which more than half of the field is not clipped.
        clear = [_unclipped(capture, table) for table in tables]
        usable_tables = [bool(np.any(usable)) and c[usable].mean() > 0.5 for c in clear]
        for c, is_usable in zip(clear, usable_tables, strict=True):
            usable = usable & c if is_usable else usable
    else:
        usable_tables = [bool(np.any(usable)) and f.saturated[usable].mean() < _MAX_CLIPPED_SHARE for f in frames]
    if usable.sum() < _MIN_PIXELS:
        return []
    points = []
    response = float(flat.response[usable].sum())
    for table, frame, is_usable in zip(tables, frames, usable_tables, strict=True):
        level = frame.signal[usable].sum() / response
        if not is_usable or level < _MIN_SIGNAL_DN:
            continue
        variance = evaluate_variance(frame.coefficients, frame.signal)[usable].sum() / response**2
        shared = float(np.sqrt(flat.relative_variance[usable].sum())) / response
        settings = {
            "exposure": table.exposure_s,
            "f_number": capture.f_number(table),
            "image_distance": capture.image_distance_mm(table),
            "flux": None if source == "scene" else _flux(capture, table, channel),
        }
        count = level * response / usable.sum() + float(dark.at(table.exposure_s)[usable].mean())
        points.append(
            ResponsePoint(
                band,
                source,
                settings,
                float(level),
                float(np.sqrt(variance)),
                count,
                len(table.frames),
                shared,
            )
        )
    return points


def measure_responses(points: tuple[ResponsePoint, ...], full_scale_dn: float) -> tuple[ResponseSeries, ...]:
    """Fit all series of three points or more in which only one setting was changed.

    Parameters
    ----------
    points
        The points of a capture.
    full_scale_dn
        Largest count, DN.

    Returns
    -------
    tuple
        One ResponseSeries per light and setting.
    """
    series = []
    for band, source in dict.fromkeys((p.band, p.source) for p in points):
        light_points = [p for p in points if (p.band, p.source) == (band, source)]
        for key, law in LAWS.items():
            others = [name for name in LAWS if name != key]
            groups: dict[tuple[float | None, ...], dict[float, ResponsePoint]] = {}
            for point in light_points:
                value = point.settings[key]
                if value is not None:
                    groups.setdefault(tuple(point.settings[o] for o in others), {})[value] = point
            for group in groups.values():
                if len(group) < 3:
                    continue
                values = np.array(sorted(group))
                series_points = [group[float(value)] for value in values]
                signal, sigma, frames = (
                    [getattr(p, name) for p in series_points] for name in ("signal_dn", "sigma_dn", "frames")
                )
                fit = fit_response(law, values, signal, sigma, full_scale_dn, frames, series_points[0].flat_sigma)
                series.append(ResponseSeries(key, band, source, fit))
    return tuple(series)


def light_series(points: tuple[ResponsePoint, ...]) -> list[LightSeries]:
    """The points as light series, one per band and source, for the calibration curve.

    Light is t f^-2 d^-2, times the flux if it is known; settings that are not stated count as 1. The counts include
    the dark level.

    Parameters
    ----------
    points
        The points of a capture.

    Returns
    -------
    list
        The series of three points or more.
    """
    series = []
    for band, source in dict.fromkeys((p.band, p.source) for p in points):
        light_points = [p for p in points if (p.band, p.source) == (band, source)]
        if len(light_points) < 3:
            continue
        light = [
            float(np.prod([(p.settings[key] or 1.0) ** law.power for key, law in LAWS.items()])) for p in light_points
        ]
        count = np.array([p.count_dn for p in light_points])
        sigma = np.array([np.hypot(p.sigma_dn, REPEATABILITY * p.signal_dn / np.sqrt(p.frames)) for p in light_points])
        series.append(LightSeries(f"{band} {source}", np.array(light), count, sigma))
    return series
