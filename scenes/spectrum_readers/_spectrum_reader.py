"""Records of the spectrum readers: reader, text of a file, spectra."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = [
    "LONGEST_NM",
    "NOT_LINEAR",
    "InstrumentFile",
    "InstrumentText",
    "MeasuredSpectrum",
    "SpectrumReader",
    "decimal_number",
    "doubtful_values",
    "fitting_units",
    "is_fraction",
    "last_spectrum",
    "measured_spectrum",
    "quantity_named",
    "states_per_cent",
    "unique_names",
]

#: Longest wavelength, nm: instruments end in the thermal infrared.
LONGEST_NM = 25000.0
#: Shortest and longest wavelength, nm, from the vacuum ultraviolet. A table beyond is in another unit than it states.
_RANGE_NM = (100.0, LONGEST_NM)
#: Factors to nm of the units of wavelengths.
_UNITS_NM = {"nm": 1.0, "um": 1000.0, "Angstrom": 0.1}
#: Largest reflectance or transmittance read as a fraction: a fluorescent paint stays below; per cent do not.
_LARGEST_FRACTION = 2.0
#: Marks of missing values, such as -999, -9999 and -1.23e34, are this or below, and below this many times the largest
#: value. Noise around zero is not.
_MISSING = -999.0
_MISSING_RATIO = -10.0
#: Fewest equal largest values in a row that are a saturated detector: a peak of whole counts may have two or three.
_FEWEST_SATURATED = 5
#: Least count of a saturated detector: that of 8 bits.
_LEAST_SATURATED = 255.0
#: Characters of a number, at most: twice those of a double in full.
_LONGEST_NUMBER = 48
#: Quantities that are fractions of the incident light.
_FRACTIONS = ("reflectance", "transmittance")
#: Quantities, by pattern of their names in a header.
_QUANTITIES = {
    "reflectance": r"refle[ck]?[tx]|remission|(?<![a-z0-9])(rs(in|ex)|%\s*r|r\s*%|r\s*[\[(]\s*%\s*[\])])(?![a-z0-9])",
    "transmittance": r"transmi|(?<![a-z0-9])(ttran|rtran|%\s*t|t\s*%|t\s*[\[(]\s*%\s*[\])])(?![a-z0-9])",
    "radiant flux": r"radiant (flux|power)|strahlungsfluss",
    "level in decibel": r"(?<![a-z])dbm?(?![a-z])",
    "refractive index": r"refractive index|brechungsindex|brechzahl",
    "absorbance": r"absorban|extinktion|optical density|(?<![a-z])o\.?d\.?(?![a-z0-9])|(?<![a-z0-9])abs\.?(?![a-z0-9])",
    "irradiance": r"irradiance|bestrahlungsst[äa]e?rke",
    "radiance": r"(?<!ir)radiance|strahldichte",
}
#: Quantities that are not linear in the light.
NOT_LINEAR = ("absorbance", "level in decibel", "refractive index")
#: Power per wavelength, and its parts: solid angle, area.
_POWER_PER_NM = re.compile(r"(?<![a-z])[mµuμ]?w(atts?)?(?=m|[^a-z]).*[nuµμ]m", re.I)
_SOLID_ANGLE = re.compile(r"(?<![a-z])sr", re.I)
_AREA = re.compile(r"sqm|(?<![a-z])[cm]?m(\^|\*\*)?[-−⁻]?[2²]|(?<=w)m[-⁻]?[2²]", re.I)
#: Quantities by unit where no name states them: whether it is per solid angle, and per area.
_OF_UNITS = {
    (True, True): "radiance",
    (False, True): "irradiance",
    (True, False): "radiant intensity",
    (False, False): "radiant flux",
}
_PER_CENT = re.compile(r"%|per\s?cent|(?<![a-z])pct(?![a-z])", re.I)
#: Number with a decimal point, and with a decimal comma.
_NUMBERS = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?"),
    ",": re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d{1,4})?"),
}
#: The same with separators of thousands, which are certain next to the decimal mark: 16.050,01 and 16,050.01.
_GROUPED = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+\.\d+"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+,\d+"),
}


@dataclass(frozen=True)
class InstrumentText:
    """Text of a file, with its path for faults."""

    #: The file.
    path: Path
    #: Its text, with line ends as "\\n".
    text: str

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text, without line ends."""
        return self.text.split("\n")

    def at(self, line: int) -> str:
        """File and line, for a fault.

        Parameters
        ----------
        line
            Number of the line, from 1.

        Returns
        -------
        str
            "FILE: line NUMBER".
        """
        return f"{self.path}: line {line}"


@dataclass(frozen=True, eq=False)
class MeasuredSpectrum:
    """A spectrum of an instrument's file."""

    #: Name by which "file:column" refers to it, without a colon.
    name: str
    #: (n,) wavelengths, ascending, nm.
    wavelength_nm: NDArray[np.float64]
    #: (n,) values, in ``unit``; fractions where the file states per cent of a reflectance or transmittance.
    values: NDArray[np.float64]
    #: Quantity that the file or its format states, such as "reflectance"; empty where it states none.
    quantity: str = ""
    #: Unit that the file or its format states, in its spelling; empty where it states none.
    unit: str = ""
    #: Factor from the numbers of the file to ``values``: 0.01 for per cent, otherwise 1.
    factor: float = 1.0


@dataclass(frozen=True)
class InstrumentFile:
    """Spectra of a file and the format they were read from."""

    #: Name of the format.
    format: str
    #: The spectra, at least one, of different names.
    spectra: tuple[MeasuredSpectrum, ...]
    #: Facts about the file, each as a sentence.
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class SpectrumReader:
    """The reader of a format."""

    #: Identifier, the name of its module.
    id: str
    #: Name of the format, for messages.
    name: str
    #: Whether a text has the marks of this format.
    recognises: Callable[[InstrumentText], bool]
    #: Spectra of a text of this format; InputError for any fault.
    read: Callable[[InstrumentText], InstrumentFile]


def is_fraction(quantity: str) -> bool:
    """Whether a quantity is a fraction of the incident light, so that per cent have a meaning.

    Parameters
    ----------
    quantity
        Name of the quantity; empty for none.

    Returns
    -------
    bool
        True for reflectance and transmittance.
    """
    return quantity in _FRACTIONS


def quantity_named(text: str) -> str:
    """The one quantity that a text names.

    Parameters
    ----------
    text
        Text of a header.

    Returns
    -------
    str
        Such as "reflectance" or "irradiance"; empty for none or several. A unit of power per nm names it, too.
    """
    names = [name for name, pattern in _QUANTITIES.items() if re.search(pattern, text, re.I)]
    if not names and (power := _POWER_PER_NM.search(text)) is not None:
        return _OF_UNITS[_SOLID_ANGLE.search(power[0]) is not None, _AREA.search(power[0]) is not None]
    return names[0] if len(names) == 1 else ""


def fitting_units(wavelengths: Sequence[float]) -> dict[str, float]:
    """Units in which numbers are wavelengths of light.

    Parameters
    ----------
    wavelengths
        Numbers of a column.

    Returns
    -------
    dict
        Factor to nm by unit, of nm, um and Angstrom, in which all of them lie between 100 nm and 25 um.
    """
    low, high = min(wavelengths), max(wavelengths)
    return {unit: f for unit, f in _UNITS_NM.items() if _RANGE_NM[0] <= low * f and high * f <= _RANGE_NM[1]}


def states_per_cent(text: str) -> bool:
    """Whether a text states per cent.

    Parameters
    ----------
    text
        Text of a header.

    Returns
    -------
    bool
        True for "%", "per cent" and "pct".
    """
    return _PER_CENT.search(text) is not None


def decimal_number(cell: str, where: str, decimal: str = ".") -> float:
    """Number of a cell.

    Parameters
    ----------
    cell
        Text of the cell.
    where
        File and line, for the fault.
    decimal
        Decimal mark, "." or ",".

    Returns
    -------
    float
        A finite number.

    Raises
    ------
    InputError
        For any other text, such as "nan", "OVER" or an empty cell.
    """
    text = cell.strip()
    if _GROUPED[decimal].fullmatch(text):
        text = text.replace("." if decimal == "," else ",", "")
    spelled = len(text) <= _LONGEST_NUMBER and _NUMBERS[decimal].fullmatch(text) is not None
    value = float(text.replace(",", ".")) if spelled else float("nan")
    if not np.isfinite(value):
        mark = "a decimal comma" if decimal == "," else "a decimal point"
        hint = "Remove the row, or measure it again."
        raise InputError(where, f"'{text[:40]}'", f"a finite number with {mark}", hint)
    return value


def last_spectrum(rows: Sequence[tuple[int, float, float]]) -> tuple[list[tuple[int, float, float]], list[str]]:
    """Last spectrum of a file that repeats its first wavelength; it has the finest step.

    Parameters
    ----------
    rows
        Line, wavelength (nm) and value of every sample, in the order of the file.

    Returns
    -------
    rows : list
        Samples of the last spectrum.
    notes : list of str
        A note where there is more than one.
    """
    starts = [index for index, row in enumerate(rows) if row[1] == rows[0][1]]
    notes = [f"The last of {len(starts)} spectra of the file."] if len(starts) > 1 else []
    return [*rows[starts[-1] :]] if starts else [], notes


def measured_spectrum(
    source: InstrumentText,
    name: str,
    rows: Sequence[tuple[int, float, float]],
    *,
    quantity: str = "",
    unit: str = "",
    per_cent: bool = False,
) -> MeasuredSpectrum:
    """Spectrum of the rows of a file, ascending, with per cent as fractions.

    Parameters
    ----------
    source
        The file.
    name
        Name of the spectrum in the file; a colon becomes a hyphen.
    rows
        Line, wavelength in nm, and value of each sample, in the order of the file.
    quantity, unit
        As in `MeasuredSpectrum`.
    per_cent
        Whether the file states that the values are per cent.

    Returns
    -------
    MeasuredSpectrum
        The spectrum.

    Raises
    ------
    InputError
        For fewer than two samples, wavelengths out of order or range, and per cent of an unnamed quantity. Also for
        values above 2 of a reflectance or transmittance that is not stated in per cent, and for marks of missing
        values.
    """
    name = " ".join(name.replace(":", "-").split())[:80]
    if len(rows) < 2:
        where = source.at(rows[0][0]) if rows else str(source.path)
        raise InputError(
            where, f"{len(rows)} samples of '{name}'", "at least two wavelengths", "Export the file again."
        )
    lines = [row[0] for row in rows]
    wavelength, values = (np.array([row[k] for row in rows]) for k in (1, 2))
    sign = 1.0 if wavelength[-1] > wavelength[0] else -1.0
    wrong = np.flatnonzero(sign * np.diff(wavelength) <= 0)
    if wrong.size:
        at = int(wrong[0])
        fault = f"{wavelength[at + 1]:g} nm after {wavelength[at]:g} nm"
        expected = "wavelengths that only ascend or only descend"
        raise InputError(source.at(lines[at + 1]), fault, expected, "Remove repeated or misplaced rows.")
    outside = np.flatnonzero((wavelength < _RANGE_NM[0]) | (wavelength > _RANGE_NM[1]))
    if outside.size:
        at = int(outside[0])
        expected = f"wavelengths from {_RANGE_NM[0]:g} to {_RANGE_NM[1]:g} nm"
        fitting = [unit for unit in fitting_units([float(value) for value in wavelength]) if unit != "nm"]
        hint = "Correct the unit of the wavelengths in the file."
        if fitting:
            hint = f"These are wavelengths in {fitting[0]}: write this unit into the header."
        raise InputError(source.at(lines[at]), f"a wavelength of {wavelength[at]:g} nm", expected, hint)
    if values.min() <= min(_MISSING, _MISSING_RATIO * values.max()):
        at = int(np.argmin(values))
        fault, expected = f"{values[at]:g} at {wavelength[at]:g} nm", "no mark of missing values among the numbers"
        raise InputError(source.at(lines[at]), fault, expected, "Remove the row, or measure it again.")
    if per_cent and not is_fraction(quantity):
        fault = f"per cent in '{name}', without the quantity"
        hint = "Name the column for its quantity, such as 'Reflectance (%)', or divide it by 100 and remove the '%'."
        raise InputError(source.at(lines[0]), fault, "per cent of a reflectance or a transmittance", hint)
    if is_fraction(quantity) and not per_cent and values.max() > _LARGEST_FRACTION:
        at = int(np.argmax(values))
        fault = f"a {quantity} of {values[at]:g} at {wavelength[at]:g} nm"
        hint = "If the values are per cent, write '%' into the header or the unit of the column."
        raise InputError(source.at(lines[at]), fault, "fractions, or per cent stated by the file", hint)
    factor = 0.01 if per_cent else 1.0
    order = slice(None) if sign > 0 else slice(None, None, -1)
    scaled = values / 100.0 if per_cent else values
    return MeasuredSpectrum(name, wavelength[order].copy(), scaled[order].copy(), quantity, unit, factor)


def doubtful_values(spectra: Sequence[MeasuredSpectrum]) -> list[str]:
    """Sentences about values that are read as the file states them, and look wrong.

    Parameters
    ----------
    spectra
        Spectra of a file.

    Returns
    -------
    list of str
        For numbers up to 1 that are stated in per cent, and for a flat top, as of a saturated detector.
    """
    sentences = []
    for spectrum in spectra:
        name, largest = f"'{spectrum.name[:60]}'", float(spectrum.values.max())
        if spectrum.factor != 1.0 and 0 < largest <= spectrum.factor:
            sentences.append(
                f"{name} is stated in per cent, and its largest number is {largest / spectrum.factor:g}: if these are "
                "fractions, remove the '%' from the file."
            )
        top = np.flatnonzero(spectrum.values == largest)
        in_a_row = bool(top.size >= _FEWEST_SATURATED and top[-1] - top[0] == top.size - 1)
        if in_a_row and largest >= _LEAST_SATURATED and top.size < spectrum.values.size:
            ends = f"{spectrum.wavelength_nm[top[0]]:g} to {spectrum.wavelength_nm[top[-1]]:g} nm"
            sentences.append(
                f"{name} is {largest:g} in all {top.size} samples from {ends}: the detector was saturated. Measure "
                "again with a shorter integration time."
            )
    return sentences


def unique_names(source: InstrumentText, spectra: Sequence[MeasuredSpectrum]) -> tuple[MeasuredSpectrum, ...]:
    """The spectra of a file, whose names must differ.

    Parameters
    ----------
    source
        The file.
    spectra
        Its spectra.

    Returns
    -------
    tuple[MeasuredSpectrum, ...]
        The same.

    Raises
    ------
    InputError
        For no spectrum, a spectrum without name, and a name that occurs twice.
    """
    names = [spectrum.name for spectrum in spectra]
    if not names:
        raise InputError(source.path, "no spectrum", "at least one spectrum", "Export it with its spectral data.")
    earlier: set[str] = set()
    for name in names:
        if not name or name in earlier:
            fault = f"the name '{name}' a second time" if name else "a spectrum without name"
            raise InputError(source.path, fault, "a different name for each spectrum", "Rename it in the file.")
        earlier.add(name)
    return tuple(spectra)
