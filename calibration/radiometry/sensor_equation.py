"""The sensor equation of a capture: counts as a function of spectral radiance.

For a band, before noise and rounding (capture format, version 1; Pattanaik et al. 1997, eqs. 2 and 3),

     DN = K flat(u, v) Int F(l) Q(l) T_lens(l) T_i(l) L(l) dl + dark(t),   K = C t / (f_number^2 d^2),

with F(l) = l / (h c) in quanta per joule (l in m), L in W m^-2 sr^-1 nm^-1, dl in nm and t in s. The image distance d
is in the unit of the focal length (mm here). For the nominal lens, C = (pi / 4) focal_length^2 pixel_area / gain.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cboxlab.scenes import NAMED_CAMERA
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import FILTER_GRID, INTEGRAL_GRID, WAVELENGTH_NM, WavelengthGrid
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture import BandTable, BracketTable, Capture
from ..instrument import (
    BandResponse,
    ResponseFactors,
    lens_constant,
    response_factors,
    rest_curve,
)

__all__ = [
    "band_responses",
    "capture_factors",
    "counts_over_constant",
    "missing_keys",
    "nominal_constant",
    "optical_factor",
    "response_curve",
]


def nominal_constant(capture: Capture) -> float | None:
    """Constant C of the nominal lens.

    Parameters
    ----------
    capture
        Capture whose lens and camera tables are used.

    Returns
    -------
    float | None
        C, mm^2 m^2 / (e-/DN); None without focal length, pixel pitch or gain, and for a camera by name, whose
        sensitivities have no level.
    """
    camera, focal = capture.manifest.camera, capture.manifest.lens.focal_length_mm
    if _is_named(capture):
        return None
    if camera.pixel_pitch_um is None or camera.gain_e_per_dn is None or focal is None:
        return None
    return lens_constant(focal, camera.pixel_pitch_um, camera.gain_e_per_dn)


def optical_factor(capture: Capture, table: BandTable | BracketTable) -> float | None:
    """Factor t / (f_number^2 d^2) of a table's frames.

    Parameters
    ----------
    capture
        Capture with the defaults of f-number and image distance.
    table
        Band or bracket with an exposure.

    Returns
    -------
    float | None
        Factor, s mm^-2; None if f-number or image distance is not stated.
    """
    f_number, distance = capture.f_number(table), capture.image_distance_mm(table)
    if f_number is None or distance is None:
        return None
    return table.exposure_s / (f_number**2 * distance**2)


def _rest_curve(capture: Capture, channel: str | None, grid: WavelengthGrid) -> NDArray[np.float64] | None:
    """(w,) F Q T_lens; None where the capture states no lens or no quantum efficiency."""
    lens, efficiency = _lens_curve(capture), capture.quantum_efficiency(channel)
    if lens is None or efficiency is None:
        return None
    return rest_curve(efficiency, lens, grid)


def _lens_curve(capture: Capture) -> Spectrum | None:
    """Transmittance of the lens; 1 where the sensitivities are those of a camera by name, None where not stated."""
    reference = capture.manifest.lens.transmittance
    if reference is not None:
        return capture.light(reference)
    return _open() if _is_named(capture) else None


def _is_named(capture: Capture) -> bool:
    """Whether the sensitivities are those of a camera by name, which are relative."""
    efficiency = capture.manifest.camera.quantum_efficiency
    return isinstance(efficiency, dict) and any(column.startswith(NAMED_CAMERA) for column in efficiency.values())


def _filter_curve(capture: Capture, band: BandTable) -> Spectrum | None:
    """Transmittance of a band's filter; 1 for a stated channel of a mosaic without a filter, None where not stated."""
    if band.transmittance is not None:
        return capture.light(band.transmittance)
    return None if band.channel is None else _open()


def _open() -> Spectrum:
    """A filter that passes everything."""
    return Spectrum(FILTER_GRID.nm, np.ones(FILTER_GRID.count), "hold")


def response_curve(capture: Capture, band: BandTable, channel: str | None = None) -> NDArray[np.float64] | None:
    """Spectral response F Q T_lens T_i of a band.

    Parameters
    ----------
    capture
        Capture with the curves of sensor and lens.
    band
        Band with a transmittance T_i.
    channel
        "R", "G" or "B" of a sensor with a mosaic; None without a mosaic.

    Returns
    -------
    NDArray | None
        (301,) response on WAVELENGTH_NM, quanta per joule; None if one of the factors is not stated.
    """
    rest, passed = _rest_curve(capture, channel, INTEGRAL_GRID), _filter_curve(capture, band)
    return None if rest is None or passed is None else rest * passed.at(WAVELENGTH_NM)


def counts_over_constant(
    capture: Capture, table: BracketTable, radiance: str, channel: str | None = None
) -> float | None:
    """Net counts of a light divided by the constant C: t f^-2 d^-2 Int F Q T L dl.

    Parameters
    ----------
    capture
        Capture with the curves and the light.
    table
        Bracket or reference table.
    radiance
        Name of the light's spectral radiance in the capture.
    channel
        Channel of a sensor with a mosaic; None without a mosaic.

    Returns
    -------
    float | None
        Counts over C, DN (e-/DN) mm^-2 m^-2; None if a table is missing or the counts are 0.
    """
    curve, factor = response_curve(capture, capture.band(table.band), channel), optical_factor(capture, table)
    if curve is None or factor is None:
        return None
    light = capture.light(radiance).at(WAVELENGTH_NM)
    unit = factor * float(np.sum(INTEGRAL_GRID.weights * curve * light))
    return unit if unit > 0 else None


def missing_keys(capture: Capture) -> tuple[str, ...]:
    """Keys that ``band_responses`` needs and that the manifest lacks.

    Parameters
    ----------
    capture
        Capture whose manifest is examined.

    Returns
    -------
    tuple[str, ...]
        Names of the keys, empty if none is missing.
    """
    manifest, missing = capture.manifest, []
    if manifest.camera.quantum_efficiency is None:
        missing.append("camera.quantum_efficiency")
    if _lens_curve(capture) is None:
        missing.append("lens.transmittance")
    for index, band in enumerate(manifest.band):
        for key in ("transmittance", "f_number", "image_distance_mm"):
            if getattr(band, key) is None and not (key == "transmittance" and band.channel is not None):
                missing.append(f"band[{index}] ({band.id}).{key}")
    return tuple(missing)


def capture_factors(
    capture: Capture,
    constant: float,
    channels: Mapping[str, str] | None = None,
    grid: WavelengthGrid = INTEGRAL_GRID,
) -> ResponseFactors:
    """Responses of all bands in factors, in the manifest's order, for a constant C.

    Parameters
    ----------
    capture
        Capture with sensor, lens, filters, f-numbers and image distances.
    constant
        C, mm^2 m^2 / (e-/DN), one for all bands.
    channels
        By band, the channel of a sensor with a mosaic; None without a mosaic.
    grid
        Wavelength grid of the responses.

    Returns
    -------
    ResponseFactors
        Filters, sensor and lens curves, and optical factors.

    Raises
    ------
    InputError
        If keys are missing; the message names them (see ``missing_keys``).
    """
    filters, rests, factors = {}, [], []
    for band in capture.manifest.band:
        rest = _rest_curve(capture, None if channels is None else channels[band.id], grid)
        factor, passed = optical_factor(capture, band), _filter_curve(capture, band)
        if rest is None or passed is None or factor is None:
            raise InputError(
                capture.folder / "capture.toml",
                f"no {', '.join(missing_keys(capture))}",
                "these keys, which an absolute scale needs",
            )
        filters[band.id] = passed
        rests.append(rest)
        factors.append(constant * factor)
    return response_factors(filters, rests, factors, grid)


def band_responses(
    capture: Capture, constant: float, channels: Mapping[str, str] | None = None
) -> tuple[BandResponse, ...]:
    """Responses of all bands: the products of ``capture_factors``.

    Parameters
    ----------
    capture
        Capture with sensor, lens, filters, f-numbers and image distances.
    constant
        C, mm^2 m^2 / (e-/DN), one for all bands.
    channels
        By band, the channel of a sensor with a mosaic; None without a mosaic.

    Returns
    -------
    tuple[BandResponse, ...]
        One response per band, in the manifest's order.

    Raises
    ------
    InputError
        If keys are missing; the message names them (see ``missing_keys``).
    """
    return capture_factors(capture, constant, channels).responses()
