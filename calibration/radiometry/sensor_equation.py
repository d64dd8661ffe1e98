"""The sensor equation of a capture: counts as a function of spectral radiance.

For a band, before noise and rounding (capture format, version 1; Pattanaik et al. 1997, eqs. 2 and 3),

     DN = K flat(u, v) Int F(l) Q(l) T_lens(l) T_i(l) L(l) dl + dark(t),   K = C t / (f_number^2 d^2),

with F(l) = l / (h c) in quanta per joule (l in m), L in W m^-2 sr^-1 nm^-1, dl in nm and t in s. The image distance d
is in the unit of the focal length (mm here). For the nominal lens, C = (pi / 4) focal_length^2 pixel_area / gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from cboxlab.scenes import NAMED_CAMERA
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM, WavelengthGrid
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
    "assumed_keys",
    "band_responses",
    "capture_factors",
    "counts_over_constant",
    "filter_steps_nm",
    "missing_keys",
    "nominal_constant",
    "optical_factor",
    "response_curve",
]

#: Transmittance of a clear path: 1 at all wavelengths of the integral.
_CLEAR = Spectrum(WAVELENGTH_NM, np.ones(WAVELENGTH_NM.size), "hold")

#: The largest step for integrals over wavelength that CIE 15 recommends.
_LARGEST_STEP_NM = 5.0


def nominal_constant(capture: Capture) -> float | None:
    """Constant C of the nominal lens.

    Parameters
    ----------
    capture
        Capture whose lens and camera tables are used.

    Returns
    -------
    float | None
        C, mm^2 m^2 / (e-/DN); None without focal length, pixel pitch or gain, and for sensitivities without
        a level, those of a camera by name or of a chart.
    """
    camera, focal = capture.manifest.camera, capture.manifest.lens.focal_length_mm
    if _is_relative(capture):
        return None
    if camera.pixel_pitch_um is None or camera.gain_e_per_dn is None or focal is None:
        return None
    fill = 1.0 if capture.reduction is None else capture.reduction.fill
    return fill * lens_constant(focal, camera.pixel_pitch_um, camera.gain_e_per_dn)


def optical_factor(capture: Capture, table: BandTable | BracketTable) -> float | None:
    """Factor t / (f_number^2 d^2) of a table's frames.

    Where the capture claims no absolute scale, an f-number or image distance that no band states is 1.

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
    if f_number is None and _is_free(capture, "f_number"):
        f_number = 1.0
    if distance is None and _is_free(capture, "image_distance_mm"):
        distance = 1.0
    if f_number is None or distance is None:
        return None
    return table.exposure_s / (f_number**2 * distance**2)


def _is_free(capture: Capture, key: str) -> bool:
    """Whether the free scale holds a key that bands may leave out."""
    manifest = capture.manifest
    one_of_all = all(getattr(band, key) is None for band in manifest.band)
    return manifest.is_free_by_band or (manifest.scale == "free" and one_of_all)


def _is_unfiltered(band: BandTable) -> bool:
    """Whether a band without a transmittance has no filter: a stated channel of a mosaic."""
    return band.transmittance is None and band.channel is not None


def _filter_of(capture: Capture, band: BandTable) -> Spectrum | None:
    """Transmittance of a band's filter, 1 without a filter; None where it is not stated."""
    if band.transmittance is not None:
        return capture.light(band.transmittance)
    return _CLEAR if _is_unfiltered(band) else None


def filter_steps_nm(capture: Capture) -> list[float]:
    """Step in which the table of each band's filter is given.

    Parameters
    ----------
    capture
        Capture with filters, which are the narrowest of its curves.

    Returns
    -------
    list of float
        (band,) largest step, nm: at most, and for bands without a filter, the largest that CIE 15 recommends.
    """
    references = [band.transmittance for band in capture.manifest.band]
    tables = [np.empty(0) if column is None else capture.light(column).wavelength_nm for column in references]
    return [min(float(np.diff(nm).max(initial=0.0)) or _LARGEST_STEP_NM, _LARGEST_STEP_NM) for nm in tables]


def _lens_of(capture: Capture) -> Spectrum | None:
    """Transmittance of the lens; None where it is not stated.

    It is 1 within a free scale, and where the sensitivities are relative.
    """
    column = capture.manifest.lens.transmittance
    if column is not None:
        return capture.light(column)
    return None if capture.manifest.is_absolute and not _is_relative(capture) else _CLEAR


def _rest_curve(
    capture: Capture, channel: str | None, grid: WavelengthGrid, displaced_nm: float = 0.0
) -> NDArray[np.float64] | None:
    """(w,) F Q T_lens; None where the capture states no lens or no quantum efficiency."""
    lens, efficiency = _lens_of(capture), capture.quantum_efficiency(channel)
    if lens is None or efficiency is None:
        return None
    if displaced_nm:
        efficiency = replace(efficiency, wavelength_nm=efficiency.wavelength_nm + displaced_nm)
    return rest_curve(efficiency, lens, grid)


def _is_relative(capture: Capture) -> bool:
    """Whether the sensitivities are relative, as those of a camera by name or of a chart are."""
    if capture.chart_sensitivities:
        return True
    efficiency = capture.manifest.camera.quantum_efficiency
    return isinstance(efficiency, dict) and any(column.startswith(NAMED_CAMERA) for column in efficiency.values())


def response_curve(
    capture: Capture, band: BandTable, channel: str | None = None, displaced_nm: float = 0.0
) -> NDArray[np.float64] | None:
    """Spectral response F Q T_lens T_i of a band.

    Parameters
    ----------
    capture
        Capture with the curves of sensor and lens.
    band
        Band with a transmittance T_i.
    channel
        "R", "G" or "B" of a sensor with a mosaic; None without a mosaic.
    displaced_nm
        Displacement of the table of Q to longer wavelengths, nm.

    Returns
    -------
    NDArray | None
        (301,) response on WAVELENGTH_NM, quanta per joule; None if one of the factors is not stated.
    """
    rest = _rest_curve(capture, channel, INTEGRAL_GRID, displaced_nm)
    transmittance = _filter_of(capture, band)
    if rest is None or transmittance is None:
        return None
    return rest * transmittance.at(WAVELENGTH_NM)


def counts_over_constant(
    capture: Capture, table: BracketTable, radiance: str, channel: str | None = None, displaced_nm: float = 0.0
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
    displaced_nm
        Displacement of the table of Q to longer wavelengths, nm.

    Returns
    -------
    float | None
        Counts over C, DN (e-/DN) mm^-2 m^-2; None if a table is missing or the counts are 0.
    """
    curve = response_curve(capture, capture.band(table.band), channel, displaced_nm)
    factor = optical_factor(capture, table)
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
    if manifest.camera.quantum_efficiency is None and not capture.chart_sensitivities:
        missing.append("camera.quantum_efficiency")
    if _lens_of(capture) is None:
        missing.append("lens.transmittance")
    for index, band in enumerate(manifest.band):
        if _filter_of(capture, band) is None:
            missing.append(f"band[{index}] ({band.id}).transmittance")
        for key in ("f_number", "image_distance_mm"):
            if getattr(band, key) is None and not _is_free(capture, key):
                missing.append(f"band[{index}] ({band.id}).{key}")
    return tuple(missing)


def assumed_keys(capture: Capture) -> tuple[str, ...]:
    """Keys that a capture without absolute scale leaves out and that are taken as 1.

    Parameters
    ----------
    capture
        Capture whose manifest is examined.

    Returns
    -------
    tuple[str, ...]
        Names of the keys; empty for a capture with an absolute scale.
    """
    manifest = capture.manifest
    if manifest.is_absolute:
        return ()
    unstated = ["lens.transmittance"] if manifest.lens.transmittance is None else []
    if any(_is_unfiltered(band) for band in manifest.band):
        unstated.append("band.transmittance")
    for key in ("f_number", "image_distance_mm"):
        if _is_free(capture, key) and any(getattr(band, key) is None for band in manifest.band):
            unstated.append(f"band.{key}")
    return tuple(unstated)


def capture_factors(
    capture: Capture,
    constant: float | NDArray[np.float64],
    channels: Mapping[str, str] | None = None,
    grid: WavelengthGrid = INTEGRAL_GRID,
) -> ResponseFactors:
    """Responses of all bands in factors, in the manifest's order, for a constant C.

    Parameters
    ----------
    capture
        Capture with sensor, lens, filters, f-numbers and image distances.
    constant
        C, mm^2 m^2 / (e-/DN), one for all bands, or (band,) one of each.
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
    of_bands = np.broadcast_to(constant, len(capture.manifest.band))
    for band, band_constant in zip(capture.manifest.band, of_bands.tolist(), strict=True):
        rest = _rest_curve(capture, None if channels is None else channels[band.id], grid)
        factor, transmittance = optical_factor(capture, band), _filter_of(capture, band)
        if rest is None or transmittance is None or factor is None:
            raise InputError(
                capture.folder / "capture.toml",
                f"no {', '.join(missing_keys(capture))}",
                "these keys, which an absolute scale needs",
            )
        filters[band.id] = transmittance
        rests.append(rest)
        factors.append(band_constant * factor)
    return response_factors(filters, rests, factors, grid)


def band_responses(
    capture: Capture, constant: float | NDArray[np.float64], channels: Mapping[str, str] | None = None
) -> tuple[BandResponse, ...]:
    """Responses of all bands: the products of ``capture_factors``.

    Parameters
    ----------
    capture
        Capture with sensor, lens, filters, f-numbers and image distances.
    constant
        C, mm^2 m^2 / (e-/DN), one for all bands, or (band,) one of each.
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
