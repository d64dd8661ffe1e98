"""Konica Minolta CS-2000 files: measurements in rows, wavelengths in columns."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._delimited import split_cells
from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    MeasuredSpectrum,
    SpectrumReader,
    decimal_number,
    measured_spectrum,
    unique_names,
)

_MAKER = re.compile(r"CS-?2000|CS-?1000|CS-S10w|KONICA MINOLTA", re.I)
_BAND = re.compile(r"(?:Le\s*)?(\d{3,4})\s*(?:nm|\[nm\]|\(nm\))?", re.I)
_NAME = re.compile(r"data\s*name|name|sample|title", re.I)
_UNIT = re.compile(r"m?W\s*/?\s*\(?(?:sr|m)[^,;\t\n\"]*nm[^,;\t\n\"\]]*")
#: Columns of wavelengths that make a header, at least.
_MIN_BANDS = 8


def _separator(line: str) -> str:
    return next((mark for mark in ("\t", ";", ",") if mark in line), ",")


def _header(source: InstrumentText) -> tuple[int, list[str]] | None:
    """Index and cells of the line that names wavelengths."""
    for index, line in enumerate(source.lines):
        cells = split_cells(line, _separator(line))
        if sum(bool(_BAND.fullmatch(cell)) for cell in cells) >= _MIN_BANDS:
            return index, cells
    return None


def _recognises(source: InstrumentText) -> bool:
    return _MAKER.search("\n".join(source.lines[:20])) is not None and _header(source) is not None


def _read(source: InstrumentText) -> InstrumentFile:
    header = _header(source)
    index, names = header if header is not None else (0, [])
    separator = _separator(source.lines[index])
    bands = {k: float(match[1]) for k, cell in enumerate(names) if (match := _BAND.fullmatch(cell))}
    label = next((k for k, cell in enumerate(names) if _NAME.fullmatch(cell)), None)
    unit = _UNIT.search(source.text)
    if unit is None:
        hint = "Export it with its units, or write 'W/(sr m2 nm)' above the header."
        raise InputError(source.at(index + 1), "radiances without a unit", "a unit in the lines above", hint)
    spectra: list[MeasuredSpectrum] = []
    for number, line in enumerate(source.lines[index + 1 :], start=index + 2):
        cells = split_cells(line, separator)
        if not cells:
            continue
        if len(cells) != len(names):
            fault, expected = f"{len(cells)} cells", f"{len(names)} as in the header, line {index + 1}"
            raise InputError(source.at(number), fault, expected, "Export the file again.")
        decimal = "," if separator != "," and any("," in cells[k] for k in bands) else "."
        rows = [(number, at, decimal_number(cells[k], source.at(number), decimal)) for k, at in bands.items()]
        name = cells[label] if label is not None else f"radiance {len(spectra) + 1}"
        spectra.append(measured_spectrum(source, name, rows, quantity="radiance", unit=unit[0].strip()))
    return InstrumentFile(READER.name, unique_names(source, spectra))


READER = SpectrumReader("cs2000", "Konica Minolta CS-2000", _recognises, _read)
