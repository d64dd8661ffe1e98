"""Checks of the manifest's spectra and numbers: units, ranges, coverage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.scenes import PHYSICAL_LIMITS, load_scene, numbers_of
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from pydantic import BaseModel

from ..capture import BandTable, BracketTable, Capture
from .frame_checks import Suspicion

__all__ = ["Column", "check_numbers", "check_scene", "check_tables", "stated_columns"]

#: Largest excess over 1 of a measured transmittance.
LARGEST_EXCESS = 0.02

#: Largest reflectance: relative to an imperfect white tile, or of a fluorescent material.
LARGEST_REFLECTANCE = 1.25

#: Smallest plausible largest value of a fraction: tables in another unit are a hundred times smaller.
SMALLEST_MAXIMUM = 5e-3

#: Smallest value of a fraction that is in per cent or in another unit.
SMALLEST_PER_CENT = 2.0

#: Largest negative value of a source over its largest: noise of its measurement.
NEGATIVE_RADIANCE_SHARE = 0.02

#: Largest share of a band's response beyond the end of a table.
LARGEST_SHARE_BEYOND = 0.02

#: Largest transmittance at the end of a filter's table over its largest.
LARGEST_END_SHARE = 0.1

#: Longest wavelength of a table in micrometres.
LONGEST_UM = 20

#: Shortest wavelength of a table in angstroms or wavenumbers.
SHORTEST_ANGSTROM = 2000

#: Longest wavelength of light in nm: a table of smaller numbers that belong to such values has its columns exchanged.
LIGHT_NM = (200, 2600)

#: Longest wavelength of a table in angstroms; larger numbers are wavenumbers.
LONGEST_ANGSTROM = 15000

#: Plausible width of a sensor, mm: 1 to 100 mm, and a factor of three.
SENSOR_WIDTH_MM = (0.3, 300)

#: Plausible image distance over the focal length.
IMAGE_DISTANCE_RATIO = (0.95, 4)

#: Smallest relative uncertainty that is in per cent.
UNCERTAINTY_PER_CENT = 0.5

#: (kind, key, reference, spectrum) of a spectrum that the manifest names.
Column = tuple[str, str, str, Spectrum]


def stated_columns(capture: Capture) -> list[Column]:
    """List every spectrum that the manifest names.

    Parameters
    ----------
    capture
        A capture.

    Returns
    -------
    list of Column
        Kind in words, key in capture.toml, reference to the file's column, spectrum.
    """
    manifest = capture.manifest
    efficiency = manifest.camera.quantum_efficiency
    columns: list[tuple[str, str, str | None]] = [
        ("quantum efficiency", "camera.quantum_efficiency", column)
        for column in (
            efficiency
            if isinstance(efficiency, tuple)
            else efficiency.values()
            if isinstance(efficiency, dict)
            else (efficiency,)
        )
    ]
    columns.append(("lens transmittance", "lens.transmittance", manifest.lens.transmittance))
    for index, band in enumerate(manifest.band):
        columns.append(("filter transmittance", f"band[{index}] ({band.id}).transmittance", band.transmittance))
    if manifest.lamp is not None:
        columns.append(("lamp radiance", "lamp.radiance", manifest.lamp.radiance))
    for index, reference in enumerate(manifest.reference):
        key = f"reference[{index}] ({reference.band}).radiance"
        columns.append(("reference radiance", key, reference.radiance))
    for index, flat in enumerate(manifest.flats):
        columns.append(("flat radiance", f"flat[{index}] ({flat.band}).radiance", flat.radiance))
    return [(kind, key, column, capture.light(column)) for kind, key, column in columns if column is not None]


def check_scene(capture: Capture) -> Iterator[Suspicion]:
    """Check that a scene file that the manifest names can be read.

    Parameters
    ----------
    capture
        A capture; a packaged scene is not checked.

    Yields
    ------
    Suspicion
        With the reason of the refusal.
    """
    scene = capture.manifest.scene
    if scene is None or not scene.endswith(".toml"):
        return
    try:
        load_scene(str(capture.scene_reference))
    except (InputError, OSError) as error:
        yield Suspicion("the scene file cannot be read", "scene", f"{error}. Checks against the box were left out.")


def check_tables(capture: Capture) -> Iterator[Suspicion]:
    """Check the units of wavelengths, the ranges of fractions, and the coverage of the tables.

    Parameters
    ----------
    capture
        A capture.

    Yields
    ------
    Suspicion
        For each table and each fault of it. Coverage is checked only if all wavelengths are in nm.
    """
    columns = stated_columns(capture)
    misread = set()
    for kind, key, reference, spectrum in _each_column_once(columns):
        name = kind if kind != "filter transmittance" else f"filter transmittance ({key})"
        unit = _wavelength_fault(name, reference, spectrum)
        if unit is not None:
            misread.add(reference)
            yield unit
        elif "radiance" in kind:
            yield from _check_radiance(kind, reference, spectrum.values)
        else:
            is_cut = kind == "filter transmittance" and any(_check_filter_ends(key, reference, spectrum, ""))
            yield from _check_fraction(name, reference, spectrum.values, 1 + LARGEST_EXCESS, is_cut=is_cut)
    for name, spectrum in capture.label_reflectances().items():
        reference = f"{capture.manifest.labels.reflectance if capture.manifest.labels else ''}:{name}"
        unit = _wavelength_fault("reflectance", reference, spectrum)
        if unit is not None:
            yield unit
        else:
            yield from _check_fraction("reflectance", reference, spectrum.values, LARGEST_REFLECTANCE)
    if not misread:
        yield from _check_coverage(capture, columns)
        yield from _check_same_filter(capture)


def _each_column_once(columns: list[Column]) -> list[Column]:
    """One entry for each column of a file, since several tables may refer to the same spectrum."""
    first: dict[str, Column] = {}
    for column in columns:
        first.setdefault(column[2], column)
    return list(first.values())


def _wavelength_fault(kind: str, reference: str, spectrum: Spectrum) -> Suspicion | None:
    """Suspicion of wavelengths that are not in nm or not visible."""
    wavelength = spectrum.wavelength_nm
    span = f"The table runs from {wavelength[0]:g} to {wavelength[-1]:g}; light is 400 to 700 nm."
    values = spectrum.values
    if (
        wavelength[-1] < LIGHT_NM[0] <= values.min() <= values.max() <= LIGHT_NM[1]
        and abs(np.sign(np.diff(values)).sum()) == values.size - 1
    ):
        evidence = f"Its values, {values[0]:g} to {values[-1]:g}, ascend or descend as wavelengths do. {span}"
        return Suspicion(f"the columns of the {kind} are exchanged: the wavelengths come second", reference, evidence)
    unit = _unit_of_wavelength(wavelength)
    if unit is not None:
        return Suspicion(f"the wavelengths of the {kind} are in {unit}, not in nm", reference, span)
    if wavelength[0] >= 700 or wavelength[-1] <= 400:
        return Suspicion(f"the {kind} table holds no visible wavelength", reference, span)
    return None


def _unit_of_wavelength(wavelength: NDArray[np.float64]) -> str | None:
    """Unit of wavelengths (n,), ascending, by their size; None for nm."""
    if wavelength[-1] <= LONGEST_UM:
        return "micrometres"
    if wavelength[0] >= SHORTEST_ANGSTROM:
        return "angstroms" if wavelength[-1] < LONGEST_ANGSTROM else "wavenumbers"
    return None


def _check_fraction(
    kind: str, reference: str, values: NDArray[np.float64], limit: float, *, is_cut: bool = False
) -> Iterator[Suspicion]:
    """Values (n,) that must lie within 0 to 1.

    limit : largest plausible value. is_cut : whether the table lacks its largest values.
    """
    top, bottom = float(values.max()), float(values.min())
    evidence = f"The largest value is {top:.4g}; a {kind} lies within 0 to 1."
    if top > max(SMALLEST_PER_CENT, limit):
        yield Suspicion(f"the {kind} is in per cent or in another unit, not a fraction", reference, evidence)
    elif top > limit:
        yield Suspicion(f"the {kind} is above 1", reference, evidence)
    elif 0 < top < SMALLEST_MAXIMUM and not is_cut:
        yield Suspicion(f"the {kind} is a hundred times too small", reference, evidence)
    if bottom < -LARGEST_EXCESS * max(top, 0.1):
        yield Suspicion(f"the {kind} is negative", reference, f"The smallest value is {bottom:.4g}.")


def _check_radiance(kind: str, reference: str, values: NDArray[np.float64]) -> Iterator[Suspicion]:
    """Values (n,) of a source, which are positive."""
    top, bottom = float(values.max()), float(values.min())
    if top <= 0 or bottom < -NEGATIVE_RADIANCE_SHARE * top:
        yield Suspicion(
            f"the {kind} is not that of a source",
            reference,
            f"Its values run from {bottom:.3g} to {top:.3g}.",
        )


def _extended(spectrum: Spectrum) -> NDArray[np.float64]:
    """(301,) on WAVELENGTH_NM, extrapolated with the end values."""
    return np.interp(WAVELENGTH_NM, spectrum.wavelength_nm, spectrum.values)


def _check_coverage(capture: Capture, columns: list[Column]) -> Iterator[Suspicion]:
    """Tables that end within a band's response."""
    responses = {
        band.id: np.prod(
            [_extended(s) for kind, key, _, s in columns if kind == "lens transmittance" or f"({band.id}).t" in key]
            or [np.ones(WAVELENGTH_NM.size)],
            axis=0,
        )
        for band in capture.manifest.band
        if band.transmittance is not None
    }
    for kind, key, reference, spectrum in _each_column_once(columns):
        low, high = spectrum.wavelength_nm[[0, -1]]
        beyond = (WAVELENGTH_NM < low) | (WAVELENGTH_NM > high)
        if not np.any(beyond):
            continue
        span = f"The table runs from {low:g} to {high:g} nm"
        if kind == "filter transmittance":
            yield from _check_filter_ends(key, reference, spectrum, span)
            continue
        lost = {band: float(curve[beyond].sum() / max(curve.sum(), 1e-300)) for band, curve in responses.items()}
        worst = max(lost, key=lost.__getitem__, default=None)
        if worst is not None and lost[worst] > LARGEST_SHARE_BEYOND:
            yield Suspicion(
                f"the table of the {kind} is cut short: it does not cover the bands",
                reference,
                f"{span}; {lost[worst]:.0%} of the light of {worst} lies beyond it.",
            )


def _check_filter_ends(key: str, reference: str, spectrum: Spectrum, span: str) -> Iterator[Suspicion]:
    """Ends of a filter's table within the visible, where it must be dark.

    span : the table's range in words.
    """
    low, high = spectrum.wavelength_nm[[0, -1]]
    for end, value in zip((low, high), spectrum.values[[0, -1]], strict=True):
        if 400 < end < 700 and value > LARGEST_END_SHARE * spectrum.values.max():
            yield Suspicion(
                f"the filter transmittance ({key}) is cut short",
                reference,
                f"{span}, where it is still {value / spectrum.values.max():.0%} of its largest value.",
            )


def _check_same_filter(capture: Capture) -> Iterator[Suspicion]:
    """Two bands with the same filter, behind a mosaic also with the same stated channel."""
    band_of: dict[tuple[str, str | None], str] = {}
    for index, band in enumerate(capture.manifest.band):
        if band.transmittance is None:
            continue
        response = band.transmittance, band.channel
        if response in band_of:
            yield Suspicion(
                f"{band.id} and {band_of[response]} state the same filter",
                f"band[{index}] ({band.id}).transmittance",
                f"Both refer to {band.transmittance}. Further exposures with the same filter must be brackets.",
            )
        band_of.setdefault(response, band.id)


def check_numbers(capture: Capture) -> Iterator[Suspicion]:
    """Check lengths, f-numbers and fractions of the manifest against the range of real cameras.

    Parameters
    ----------
    capture
        A capture.

    Yields
    ------
    Suspicion
        For the sensor's width, the first image distance, numbers of an unusual size, and the lamp's uncertainties.
    """
    yield from _check_sensor_width(capture)
    yield from _check_image_distance(capture, _lit_tables(capture))
    yield from _check_usual(capture.manifest)
    yield from _check_lamp_uncertainty(capture)


def _lit_tables(capture: Capture) -> list[tuple[str, BandTable | BracketTable]]:
    """All tables of frames with light, with their keys."""
    manifest = capture.manifest
    return [
        *((f"band[{i}] ({b.id})", b) for i, b in enumerate(manifest.band)),
        *((f"bracket[{i}] ({b.band})", b) for i, b in enumerate(manifest.bracket)),
        *((f"flat[{i}] ({b.band})", b) for i, b in enumerate(manifest.flats)),
        *((f"reference[{i}] ({b.band})", b) for i, b in enumerate(manifest.reference)),
    ]


def _check_sensor_width(capture: Capture) -> Iterator[Suspicion]:
    """Pixel pitch by the width of the sensor."""
    manifest = capture.manifest
    camera = manifest.camera
    if camera.pixel_pitch_um is not None:
        width = (manifest.crop.full_width_px if manifest.crop else camera.width_px) * camera.pixel_pitch_um / 1e3
        if not SENSOR_WIDTH_MM[0] < width < SENSOR_WIDTH_MM[1]:
            yield Suspicion(
                "the pixel pitch is in another unit than um",
                "camera.pixel_pitch_um",
                f"With {camera.pixel_pitch_um:g} um the sensor is {width:.3g} mm wide; sensors are 1 to 100 mm wide.",
            )


def _check_usual(manifest: BaseModel) -> Iterator[Suspicion]:
    """Numbers that are possible, and that hardly a laboratory has, once for each key."""
    unusual: dict[str, tuple[str, float]] = {}
    for where, key, value in _numbers(manifest, ""):
        if not PHYSICAL_LIMITS[key].is_usual(value):
            unusual.setdefault(key, (where, value))
    for key, (where, value) in unusual.items():
        limits = PHYSICAL_LIMITS[key]
        unit = f" {limits.unit}" if limits.unit else ""
        name = key.removesuffix("_mm").removesuffix("_um").removesuffix("_px").removesuffix("_s").replace("_", " ")
        yield Suspicion(
            f"the {name} is in another unit, or mistyped", where, f"It is {value:g}{unit}; {limits.reason}."
        )


def _numbers(table: BaseModel, where: str) -> Iterator[tuple[str, str, float]]:
    """Place in capture.toml, key and value of every number with limits."""
    for key in type(table).model_fields:
        value, inner = getattr(table, key), f"{where}{key}"
        if isinstance(value, BaseModel):
            yield from _numbers(value, f"{inner}.")
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            for index, each in enumerate(value):
                yield from _numbers(each, f"{inner}[{index}].")
        elif key in PHYSICAL_LIMITS:
            yield from ((inner, key, number) for number in numbers_of(value))


def _check_image_distance(
    capture: Capture, lit_tables: list[tuple[str, BandTable | BracketTable]]
) -> Iterator[Suspicion]:
    """The first image distance that does not suit the focal length."""
    focal = capture.manifest.lens.focal_length_mm
    nearest, farthest = IMAGE_DISTANCE_RATIO
    for key, table in lit_tables:
        distance = table.image_distance_mm
        if distance is not None and focal is not None and not nearest * focal <= distance <= farthest * focal:
            yield Suspicion(
                "the image distance does not suit the focal length (a length in another unit, or exchanged)",
                f"{key}.image_distance_mm",
                f"The image distance is {distance:g} mm, the focal length {focal:g} mm; a lens forms its image at one "
                "to a few focal lengths.",
            )
            break


def _check_lamp_uncertainty(capture: Capture) -> Iterator[Suspicion]:
    """Relative uncertainties of the lamp that are in per cent."""
    lamp = capture.manifest.lamp
    for name in ("relative_uncertainty", "spectral_uncertainty"):
        value = None if lamp is None else getattr(lamp, name)
        if value is not None and value >= UNCERTAINTY_PER_CENT:
            yield Suspicion(
                "the lamp's uncertainty is in per cent, not a fraction", f"lamp.{name}", f"It is {value:g}."
            )
