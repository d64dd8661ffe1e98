"""Reflectances of paints and spectra of lamps by the names of their sources."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from cboxlab.scenes.cornell_box import cornell_box
from cboxlab.scenes.named_lights import LIGHT_NAMES, named_light
from cboxlab.scenes.spectra import Spectrum, planck, read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, referred, suggestion

__all__ = ["light_source", "planck_light", "reflectance_source"]

#: Function that returns a reflectance, since some are computed.
Reflectance: TypeAlias = "Callable[[], Spectrum]"

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


def reflectance_source(name: str, folder: Path, where: str) -> tuple[tuple[str, Reflectance], ...]:
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
        Names, such as "munsell:5R 5/8", with functions that return their reflectances, 0 to 1.

    Raises
    ------
    InputError
        If the source is unknown, or a table is none of reflectances.
    """
    source, separator, member = name.partition(":")
    if source in _COLLECTIONS:
        spectra: Mapping[str, Reflectance] = _collection(source)
    elif source.endswith(".csv"):
        table = _table(source, folder, where, "hold")
        for key, spectrum in table.items():
            if spectrum.values.min() < 0 or spectrum.values.max() > 1:
                bounds = f"{spectrum.values.min():g} to {spectrum.values.max():g} in {source}:{key}"
                raise InputError(where, bounds, "reflectances from 0 to 1")
        spectra = {key: partial(_as_it_is, spectrum) for key, spectrum in table.items()}
    else:
        raise InputError(where, f"'{name}'", _REFLECTANCE_NAMES, suggestion(source, _COLLECTIONS))
    if separator:
        if member not in spectra:
            members = list(spectra)
            listed = ", ".join(members[:12]) + (", ..." if len(members) > 12 else "")
            raise InputError(where, f"'{member}' in {source}", f"one of {listed}", suggestion(member, members))
        spectra = {member: spectra[member]}
    return tuple((f"{source}:{key}", reflectance) for key, reflectance in spectra.items())


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
    spectra = _table(source, folder, where, "zero")
    if member not in spectra:
        expected = f"one of {', '.join(spectra)}"
        raise InputError(where, f"'{member}' in {source}", expected, suggestion(member, spectra))
    light = spectra[member]
    if light.values.min() < 0 or not light.at(np.arange(400.0, 701.0)).any():
        raise InputError(where, f"a negative value or no light in {name}", "a spectrum with light from 400 to 700 nm")
    return light


def _table(name: str, folder: Path, where: str, beyond: Literal["hold", "zero"]) -> Mapping[str, Spectrum]:
    """Spectra of a CSV file by column."""
    path = path_inside(folder, name, where)
    try:
        return read_spectra(path, beyond)
    except InputError as fault:
        raise referred(fault, where) from None


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
def _collection(source: str) -> Mapping[str, Reflectance]:
    """Reflectances of a collection by name."""
    if source == "cornell-box":
        paints = cornell_box().materials
        return {name: partial(getattr, material, "reflectance") for name, material in paints.items()}
    if source == "munsell":
        from colour import MUNSELL_COLOURS

        colours = MUNSELL_COLOURS["Munsell Colours 1929"]
        names = [(f"{hue} {value:g}/{chroma:g}", tuple(xyy)) for (hue, value, chroma), xyy in colours]
        return {name: partial(_recovered, xyy) for name, xyy in names}
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
        columns = enumerate(samples.values.T, start=1)
        return {f"{number}": partial(_reflectance, samples.wavelengths, column) for number, column in columns}
    return {str(name): partial(_reflectance, table.wavelengths, table.values) for name, table in tables.items()}


def _reflectance(wavelength_nm: object, values: object) -> Spectrum:
    """Reflectance of a table, with rounding beyond 0 to 1 cut off."""
    return Spectrum(np.asarray(wavelength_nm, float), np.clip(np.asarray(values, float), 0.0, 1.0))


@lru_cache(maxsize=1024)
def _recovered(xyy: tuple[float, float, float]) -> Spectrum:
    """Reflectance of a Munsell colour, recovered from its x, y and Y under illuminant C.

    The method is that of Otsu, Yamamoto and Hachisuka 2018.
    """
    from colour import xyY_to_XYZ
    from colour.recovery import XYZ_to_sd_Otsu2018

    observer, light = _observer_and_light()
    xyz = np.asarray(xyY_to_XYZ(np.array(xyy))) / 100
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that tables are aligned
        table = XYZ_to_sd_Otsu2018(xyz, observer, light)
    return _reflectance(_RECOVERED_NM, table.values)


@lru_cache(maxsize=1)
def _observer_and_light() -> tuple[Any, Any]:
    """CIE 1931 observer and illuminant C at the wavelengths of recovered reflectances."""
    from colour import MSDS_CMFS, SDS_ILLUMINANTS, SpectralShape

    shape = SpectralShape(_RECOVERED_NM[0], _RECOVERED_NM[-1], _RECOVERED_NM[1] - _RECOVERED_NM[0])
    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    return observer, SDS_ILLUMINANTS["C"].copy().align(shape)


def _as_it_is(spectrum: Spectrum) -> Spectrum:
    """The spectrum of a table."""
    return spectrum
