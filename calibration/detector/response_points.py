"""The exposures of a capture as points of response series: the settings and the counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.utils.frozen import OwnMappings
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

# Points with a larger share of clipped pixels are left out.
_CLIPPED_SHARE = 1e-3
# The sensor equation holds near the axis: use this share of the field's width and height, in the middle.
_MIDDLE = 0.5
_FEWEST_PIXELS = 16
# Range of counts used: above the bias by rounding and clipping at 0, below the clipping of single pixels.
_LOWEST_DN = 3.0
_HIGHEST_SHARE = 0.92


@dataclass(frozen=True)
class ResponsePoint(OwnMappings):
    """One exposure of a steady light.

    source : "reference", "flat" or "scene". settings : by key of LAWS, None where not stated; the flux is
    Int F Q T L dl of the reference, proportional to photoelectrons per second.
    signal_dn, sigma_dn : mean above dark over the middle of the field, flat-corrected, and its standard deviation
    by noise. flat_sigma : relative standard deviation by the flat, common to all points of one light.
    count_dn : mean count as stored, dark included. frames : repeats averaged.
    """

    band: str
    source: str
    settings: Mapping[str, float | None]
    signal_dn: float
    sigma_dn: float
    count_dn: float
    frames: int = 1
    flat_sigma: float = 0.0


@dataclass(frozen=True, eq=False)
class ResponseSeries:
    """Points of one light in which only the setting ``key`` (of LAWS) was changed, and their fit."""

    key: str
    band: str
    source: str
    fit: ResponseFit


def _middle(shape: tuple[int, int]) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = np.zeros(shape, bool)
    margins = [round(size * (1 - _MIDDLE) / 2) for size in shape]
    inside[margins[0] : shape[0] - margins[0], margins[1] : shape[1] - margins[1]] = True
    return inside


def _unclipped(capture: Capture, table: BandTable | BracketTable) -> NDArray[np.bool_]:
    """(y, x) True where a pixel and its neighbours are well below the largest count in all repeats."""
    brightest = maximum_filter(capture.frames(table).max(axis=0), 3)
    return np.asarray(brightest < _HIGHEST_SHARE * capture.saturation_dn, np.bool_)


def _flux(capture: Capture, table: BandTable | BracketTable, channel: str | None) -> float | None:
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
    """Points of all references, all flats with a stated radiance, and the scene where a band has three exposures.

    Points with clipped pixels are left out. The scene's points are means over the pixels that are not clipped in
    any of its exposures used. Raises InputError for a faulty frame.
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
    if not tables:
        return []
    band = tables[0].id if isinstance(tables[0], BandTable) else tables[0].band
    flat = uniform_flat(capture.shape, dark) if source == "flat" else bands.flats[band]
    frames = [correct(capture, table, uniform_flat(capture.shape, dark), dark, noise) for table in tables]
    if source == "scene":
        # Keep the exposures in which more than half of the field is not clipped.
        clear = [_unclipped(capture, table) for table in tables]
        whole = [bool(np.any(usable)) and c[usable].mean() > 0.5 for c in clear]
        for c, keep in zip(clear, whole, strict=True):
            usable = usable & c if keep else usable
    else:
        whole = [bool(np.any(usable)) and f.saturated[usable].mean() < _CLIPPED_SHARE for f in frames]
    if usable.sum() < _FEWEST_PIXELS:
        return []
    points = []
    response = float(flat.response[usable].sum())
    for table, frame, keep in zip(tables, frames, whole, strict=True):
        level = frame.signal[usable].sum() / response
        if not keep or level < _LOWEST_DN:
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
    """Fits of all series of at least three points of one light in which only one setting was changed."""
    found = []
    for band, source in dict.fromkeys((p.band, p.source) for p in points):
        own = [p for p in points if (p.band, p.source) == (band, source)]
        for key, law in LAWS.items():
            others = [name for name in LAWS if name != key]
            groups: dict[tuple[float | None, ...], dict[float, ResponsePoint]] = {}
            for point in own:
                value = point.settings[key]
                if value is not None:
                    groups.setdefault(tuple(point.settings[o] for o in others), {})[value] = point
            for group in groups.values():
                if len(group) < 3:
                    continue
                values = np.array(sorted(group))
                chosen = [group[float(value)] for value in values]
                signal, sigma, frames = (
                    [getattr(p, name) for p in chosen] for name in ("signal_dn", "sigma_dn", "frames")
                )
                fit = fit_response(law, values, signal, sigma, full_scale_dn, frames, chosen[0].flat_sigma)
                found.append(ResponseSeries(key, band, source, fit))
    return tuple(found)


def light_series(points: tuple[ResponsePoint, ...]) -> list[LightSeries]:
    """The points as light series, one per band and source; light is t f^-2 d^-2, times the flux if it is known.

    Series of fewer than three points are left out. The counts include the dark level.
    """
    series = []
    for band, source in dict.fromkeys((p.band, p.source) for p in points):
        own = [p for p in points if (p.band, p.source) == (band, source)]
        if len(own) < 3:
            continue
        light = [float(np.prod([(p.settings[key] or 1.0) ** law.power for key, law in LAWS.items()])) for p in own]
        count = np.array([p.count_dn for p in own])
        sigma = np.array([np.hypot(p.sigma_dn, REPEATABILITY * p.signal_dn / np.sqrt(p.frames)) for p in own])
        series.append(LightSeries(f"{band} {source}", np.array(light), count, sigma))
    return series
