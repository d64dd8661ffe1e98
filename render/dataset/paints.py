"""Reflectances of paints and spectra of lamps by the names of their sources."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from cboxlab.scenes.cornell_box import cornell_box
from cboxlab.scenes.named_lights import LIGHT_NAMES, named_light
from cboxlab.scenes.spectra import Spectrum, planck, read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, suggestion

__all__ = ["light_source", "planck_light", "reflectance_source"]

#: Sources of many reflectances, by the functions that read them.
_COLLECTIONS = ("cornell-box", "colorchecker", "cie-1995", "cie-224", "munsell")

#: Names of reflectances for messages.
_REFLECTANCE_NAMES = (
    f"one of {', '.join(_COLLECTIONS)}, one of their spectra as 'cornell-box:white', a CSV file, or a column of it as "
    "'paints.csv:red'"
)

#: Names of lights for messages.
_LIGHT_EXPECTED = f"'planck' with temperature_k, 'cornell-box', {LIGHT_NAMES}, or a column of a CSV as 'lamps.csv:led'"

#: Wavelengths of the reflectances that are recovered from colours, nm.
_RECOVERED_NM = np.arange(380.0, 731.0, 10.0)

#: Wavelengths of a black body's table, nm.
_PLANCK_NM = np.arange(300.0, 1101.0, 5.0)


def reflectance_source(name: str, folder: Path, where: str) -> tuple[tuple[str, Spectrum], ...]:
    """Reflectances of a source.

    Parameters
    ----------
    name
        A collection, one spectrum of it, a CSV file, or one column of it.
    folder
        Folder of the recipe.
    where
        File and key for errors.

    Returns
    -------
    tuple
        Names, such as "munsell:5R 5/8", with their reflectances, 0 to 1.

    Raises
    ------
    InputError
        If the source is unknown, or a table is none of reflectances.
    """
    source, separator, member = name.partition(":")
    if source in _COLLECTIONS:
        spectra = _collection(source)
    elif source.endswith(".csv"):
        spectra = dict(read_spectra(path_inside(folder, source, where), "hold"))
    else:
        raise InputError(where, f"'{name}'", _REFLECTANCE_NAMES, suggestion(source, _COLLECTIONS))
    if separator:
        if member not in spectra:
            members = list(spectra)
            listed = ", ".join(members[:12]) + (", ..." if len(members) > 12 else "")
            raise InputError(where, f"'{member}' in {source}", f"one of {listed}", suggestion(member, members))
        spectra = {member: spectra[member]}
    for key, spectrum in spectra.items():
        if spectrum.values.min() < 0 or spectrum.values.max() > 1:
            bounds = f"{spectrum.values.min():g} to {spectrum.values.max():g} in {source}:{key}"
            raise InputError(where, bounds, "reflectances from 0 to 1")
    return tuple((f"{source}:{key}", spectrum) for key, spectrum in spectra.items())


def light_source(name: str, folder: Path, where: str) -> Spectrum | None:
    """Relative spectrum of a lamp.

    Parameters
    ----------
    name
        Name of a light, or a column of a CSV file.
    folder
        Folder of the recipe.
    where
        File and key for errors.

    Returns
    -------
    Spectrum or None
        The spectrum, zero beyond its table; None for "planck", whose temperature is drawn.

    Raises
    ------
    InputError
        If the source is unknown, or the spectrum has no light between 400 and 700 nm.
    """
    if name == "planck":
        return None
    if name == "cornell-box":
        return cornell_box().lamp.radiance
    light = named_light(name)
    if light is not None:
        return light
    source, _, member = name.rpartition(":")
    if not source.endswith(".csv"):
        raise InputError(where, f"'{name}'", _LIGHT_EXPECTED, suggestion(name, ("planck", "cornell-box")))
    spectra = read_spectra(path_inside(folder, source, where), "zero")
    if member not in spectra:
        expected = f"one of {', '.join(spectra)}"
        raise InputError(where, f"'{member}' in {source}", expected, suggestion(member, spectra))
    light = spectra[member]
    if light.values.min() < 0 or not light.at(np.arange(400.0, 701.0)).any():
        raise InputError(where, f"a negative value or no light in {name}", "a spectrum with light from 400 to 700 nm")
    return light


def planck_light(temperature_k: float) -> Spectrum:
    """Relative spectrum of a black body.

    Parameters
    ----------
    temperature_k
        Temperature, K.

    Returns
    -------
    Spectrum
        1 at its greatest value, zero beyond 300 to 1100 nm.
    """
    values = planck(_PLANCK_NM, temperature_k)
    return Spectrum(_PLANCK_NM, values / values.max(), "zero")


@lru_cache(maxsize=len(_COLLECTIONS))
def _collection(source: str) -> dict[str, Spectrum]:
    """Reflectances of a collection by name."""
    if source == "cornell-box":
        return {name: material.reflectance for name, material in cornell_box().materials.items()}
    if source == "munsell":
        return _munsell()
    if source == "colorchecker":
        from colour import SDS_COLOURCHECKERS

        tables = SDS_COLOURCHECKERS["ISO 17321-1"]
    elif source == "cie-1995":
        from colour.quality import SDS_TCS

        tables = SDS_TCS["CIE 1995"]
    else:
        from colour.colorimetry import SpectralShape
        from colour.quality.cfi2017 import load_TCS_CIE2017

        samples = load_TCS_CIE2017(SpectralShape(380, 780, 1))
        return {
            f"{index + 1}": _reflectance(samples.wavelengths, column) for index, column in enumerate(samples.values.T)
        }
    return {str(name): _reflectance(table.wavelengths, table.values) for name, table in tables.items()}


def _reflectance(wavelength_nm: object, values: object) -> Spectrum:
    """Reflectance of a table, with rounding beyond 0 to 1 cut off."""
    return Spectrum(np.asarray(wavelength_nm, float), np.clip(np.asarray(values, float), 0.0, 1.0))


def _munsell() -> dict[str, Spectrum]:
    """Reflectances of Munsell's colours of 1929.

    They are spectra of the published colours under illuminant C, recovered by the method of Otsu, Yamamoto and
    Hachisuka 2018.
    """
    from colour import MSDS_CMFS, MUNSELL_COLOURS, SDS_ILLUMINANTS, SpectralShape, xyY_to_XYZ
    from colour.recovery import XYZ_to_sd_Otsu2018

    shape = SpectralShape(380, 730, 10)
    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    light = SDS_ILLUMINANTS["C"].copy().align(shape)
    spectra = {}
    for (hue, value, chroma), xyy in MUNSELL_COLOURS["Munsell Colours 1929"]:
        xyz = np.asarray(xyY_to_XYZ(xyy)) / 100
        table = XYZ_to_sd_Otsu2018(xyz, observer, light)
        spectra[f"{hue} {value:g}/{chroma:g}"] = _reflectance(_RECOVERED_NM, table.values)
    return spectra
