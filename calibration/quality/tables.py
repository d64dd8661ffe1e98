"""Checks of the manifest's spectra and numbers: units, ranges, coverage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.scenes import load_scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture import BandTable, BracketTable, Capture
from .suspicion import Suspicion

__all__ = ["Column", "check_numbers", "check_scene", "check_tables", "stated_columns"]

#: Largest excess over 1 of a measured transmittance.
_ABOVE_ONE = 0.02
#: Largest reflectance: relative to an imperfect white tile, or of a fluorescent material.
_BRIGHTEST_REFLECTANCE = 1.25
#: Largest share of a band's response, or of a table's maximum, beyond the end of a table.
_BEYOND = 0.02
_CUT = 0.1

Column = tuple[str, str, str, Spectrum]


def stated_columns(capture: Capture) -> list[Column]:
    """(kind, key, reference, spectrum) of every spectrum that the manifest names."""
    manifest = capture.manifest
    efficiency = manifest.camera.quantum_efficiency
    stated: list[tuple[str, str, str | None]] = [
        ("quantum efficiency", "camera.quantum_efficiency", column)
        for column in (efficiency if isinstance(efficiency, tuple) else (efficiency,))
    ]
    stated.append(("lens transmittance", "lens.transmittance", manifest.lens.transmittance))
    for index, band in enumerate(manifest.band):
        stated.append(("filter transmittance", f"band[{index}] ({band.id}).transmittance", band.transmittance))
    if manifest.lamp is not None:
        stated.append(("lamp radiance", "lamp.radiance", manifest.lamp.radiance))
    for index, reference in enumerate(manifest.reference):
        key = f"reference[{index}] ({reference.band}).radiance"
        stated.append(("reference radiance", key, reference.radiance))
    for index, flat in enumerate(manifest.flats):
        stated.append(("flat radiance", f"flat[{index}] ({flat.band}).radiance", flat.radiance))
    return [(kind, key, column, capture.light(column)) for kind, key, column in stated if column is not None]


def check_scene(capture: Capture) -> Iterator[Suspicion]:
    """Whether a scene file that the manifest names can be read."""
    stated = capture.manifest.scene
    if stated is None or not stated.endswith(".toml"):
        return
    try:
        load_scene(str(capture.scene_reference))
    except (InputError, OSError) as error:
        yield Suspicion("the scene file cannot be read", "scene", f"{error}. Checks against the box were left out.")


def _once(columns: list[Column]) -> list[Column]:
    """One entry for each column of a file, since several tables may refer to the same spectrum."""
    first: dict[str, Column] = {}
    for column in columns:
        first.setdefault(column[2], column)
    return list(first.values())


def _unit_of_wavelength(wavelength: NDArray[np.float64]) -> str | None:
    if wavelength[-1] <= 20:
        return "micrometres"
    if wavelength[0] >= 2000:
        return "angstroms" if wavelength[-1] < 15000 else "wavenumbers"
    return None


def _wavelengths(kind: str, reference: str, spectrum: Spectrum) -> Suspicion | None:
    wavelength = spectrum.wavelength_nm
    span = f"The table runs from {wavelength[0]:g} to {wavelength[-1]:g}; light is 400 to 700 nm."
    unit = _unit_of_wavelength(wavelength)
    if unit is not None:
        return Suspicion(f"the wavelengths of the {kind} are in {unit}, not in nm", reference, span)
    if wavelength[0] >= 700 or wavelength[-1] <= 400:
        return Suspicion(f"the {kind} table holds no visible wavelength", reference, span)
    return None


def _fractions(kind: str, reference: str, values: NDArray[np.float64], limit: float) -> Iterator[Suspicion]:
    top, bottom = float(values.max()), float(values.min())
    found = f"The largest value is {top:.4g}; a {kind} lies within 0 to 1."
    if top > max(2.0, limit):
        yield Suspicion(f"the {kind} is in per cent or in another unit, not a fraction", reference, found)
    elif top > limit:
        yield Suspicion(f"the {kind} is above 1", reference, found)
    elif 0 < top < 5e-3:
        yield Suspicion(f"the {kind} is a hundred times too small", reference, found)
    if bottom < -_ABOVE_ONE * max(top, 0.1):
        yield Suspicion(f"the {kind} is negative", reference, f"The smallest value is {bottom:.4g}.")


def _radiances(kind: str, reference: str, values: NDArray[np.float64]) -> Iterator[Suspicion]:
    top, bottom = float(values.max()), float(values.min())
    if top <= 0 or bottom < -0.02 * top:
        yield Suspicion(
            f"the {kind} is not that of a source",
            reference,
            f"Its values run from {bottom:.3g} to {top:.3g}.",
        )


def check_tables(capture: Capture) -> Iterator[Suspicion]:
    """Checks the units of wavelengths, the ranges of fractions, and the coverage of the tables."""
    columns = stated_columns(capture)
    misread = set()
    for kind, key, reference, spectrum in _once(columns):
        name = kind if kind != "filter transmittance" else f"filter transmittance ({key})"
        unit = _wavelengths(name, reference, spectrum)
        if unit is not None:
            misread.add(reference)
            yield unit
        elif "radiance" in kind:
            yield from _radiances(kind, reference, spectrum.values)
        else:
            yield from _fractions(name, reference, spectrum.values, 1 + _ABOVE_ONE)
    for name, spectrum in capture.label_reflectances().items():
        reference = f"{capture.manifest.labels.reflectance if capture.manifest.labels else ''}:{name}"
        unit = _wavelengths("reflectance", reference, spectrum)
        if unit is not None:
            yield unit
        else:
            yield from _fractions("reflectance", reference, spectrum.values, _BRIGHTEST_REFLECTANCE)
    if not misread:
        yield from _coverage(capture, columns)
        yield from _same_filter(capture)


def _held(spectrum: Spectrum) -> NDArray[np.float64]:
    """(301,) on WAVELENGTH_NM, extrapolated with the end values."""
    return np.interp(WAVELENGTH_NM, spectrum.wavelength_nm, spectrum.values)


def _coverage(capture: Capture, columns: list[Column]) -> Iterator[Suspicion]:
    """Detects tables that end within a band's response."""
    used = {
        band.id: np.prod(
            [_held(s) for kind, key, _, s in columns if kind == "lens transmittance" or f"({band.id}).t" in key]
            or [np.ones(WAVELENGTH_NM.size)],
            axis=0,
        )
        for band in capture.manifest.band
        if band.transmittance is not None
    }
    for kind, key, reference, spectrum in _once(columns):
        low, high = spectrum.wavelength_nm[[0, -1]]
        out = (WAVELENGTH_NM < low) | (WAVELENGTH_NM > high)
        if not np.any(out):
            continue
        span = f"The table runs from {low:g} to {high:g} nm"
        if kind == "filter transmittance":
            ends = [
                value
                for end, value in zip((low, high), spectrum.values[[0, -1]], strict=True)
                if 400 < end < 700 and value > _CUT * spectrum.values.max()
            ]
            for value in ends:
                yield Suspicion(
                    f"the filter transmittance ({key}) is cut short",
                    reference,
                    f"{span}, where it is still {value / spectrum.values.max():.0%} of its largest value.",
                )
            continue
        lost = {band: float(curve[out].sum() / max(curve.sum(), 1e-300)) for band, curve in used.items()}
        worst = max(lost, key=lost.__getitem__, default=None)
        if worst is not None and lost[worst] > _BEYOND:
            yield Suspicion(
                f"the table of the {kind} is cut short: it does not cover the bands",
                reference,
                f"{span}; {lost[worst]:.0%} of the light of {worst} lies beyond it.",
            )


def _same_filter(capture: Capture) -> Iterator[Suspicion]:
    """Detects two bands with the same filter."""
    seen: dict[str, str] = {}
    for index, band in enumerate(capture.manifest.band):
        if band.transmittance is None:
            continue
        if band.transmittance in seen:
            yield Suspicion(
                f"{band.id} and {seen[band.transmittance]} state the same filter",
                f"band[{index}] ({band.id}).transmittance",
                f"Both refer to {band.transmittance}. Further exposures with the same filter must be brackets.",
            )
        seen.setdefault(band.transmittance, band.id)


def check_numbers(capture: Capture) -> Iterator[Suspicion]:
    """Checks lengths, times and fractions of the manifest against the range of real cameras."""
    manifest = capture.manifest
    camera, focal = manifest.camera, manifest.lens.focal_length_mm
    if camera.pixel_pitch_um is not None:
        width = (manifest.crop.full_width_px if manifest.crop else camera.width_px) * camera.pixel_pitch_um / 1e3
        if not 0.3 < width < 300:
            yield Suspicion(
                "the pixel pitch is in another unit than um",
                "camera.pixel_pitch_um",
                f"With {camera.pixel_pitch_um:g} um the sensor is {width:.3g} mm wide; sensors are 1 to 100 mm wide.",
            )
    if focal is not None and not 1 < focal < 3000:
        yield Suspicion("the focal length is in another unit than mm", "lens.focal_length_mm", f"It is {focal:g} mm.")
    lit: list[tuple[str, BandTable | BracketTable]] = [
        *((f"band[{i}] ({b.id})", b) for i, b in enumerate(manifest.band)),
        *((f"bracket[{i}] ({b.band})", b) for i, b in enumerate(manifest.bracket)),
        *((f"flat[{i}] ({b.band})", b) for i, b in enumerate(manifest.flats)),
        *((f"reference[{i}] ({b.band})", b) for i, b in enumerate(manifest.reference)),
    ]
    for key, table in lit:
        distance = table.image_distance_mm
        if distance is not None and focal is not None and not 0.95 * focal <= distance <= 4 * focal:
            yield Suspicion(
                "the image distance does not suit the focal length (a length in another unit, or exchanged)",
                f"{key}.image_distance_mm",
                f"The image distance is {distance:g} mm, the focal length {focal:g} mm; a lens forms its image at one "
                "to a few focal lengths.",
            )
            break
    numbers = [table.f_number for _, table in lit if table.f_number]
    if numbers and not 0.5 <= min(numbers) <= max(numbers) <= 64:
        yield Suspicion(
            "the f-number is no f-number",
            "band.f_number",
            f"They run from {min(numbers):g} to {max(numbers):g}; lenses have 0.7 to 45.",
        )
    lamp = manifest.lamp
    for name in ("relative_uncertainty", "spectral_uncertainty"):
        value = None if lamp is None else getattr(lamp, name)
        if value is not None and value >= 0.5:
            yield Suspicion(
                "the lamp's uncertainty is in per cent, not a fraction", f"lamp.{name}", f"It is {value:g}."
            )
