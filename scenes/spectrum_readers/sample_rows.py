"""Tables with a sample in each row: of spectrophotometers and of the CS-2000."""

from __future__ import annotations

import re

import numpy as np
from cboxlab.utils.errors import InputError

from ._delimited import split_cells
from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    MeasuredSpectrum,
    SpectrumReader,
    decimal_number,
    is_fraction,
    measured_spectrum,
    quantity_named,
    states_per_cent,
    unique_names,
)

#: Makers and programs of radiance meters.
_RADIANCE_METER = re.compile(r"CS-?2000|CS-?1000|CS-S10w", re.I)
_MAKER = re.compile(_RADIANCE_METER.pattern + "|KONICA MINOLTA", re.I)
#: Programs whose reflectances and transmittances are per cent without a sign.
_IN_PER_CENT = re.compile(r"Hunter\s?Lab|EasyMatch", re.I)
#: Header of a column of one wavelength: 400, 400nm, Le 400 [nm], R400, %R 400 nm, SPECTRAL_NM400, Ee(400nm)[W/m2/nm].
_BAND = re.compile(
    r"(?:[a-z%_]{1,24}\s*[\[(]?\s*)?(\d{3,4}(?:\.\d+)?)\s*(?:nm|\[nm\]|\(nm\))?[\])]?(?:\[[^\]]*\])?", re.I
)
_NAME = re.compile(r"(data|sample|specimen)?[ _]*(name|sample|title|specimen)", re.I)
_UNIT = re.compile(r"[mµuμ]?W\s*/?\s*\(?(?:sr|m|cm)[^,;\t\n\"]*nm[^,;\t\n\"\]]*")
#: Columns of wavelengths that make a header, at least.
_MIN_BANDS = 8
#: Largest value that may be a fraction, where neither quantity nor unit are stated.
_LARGEST_FRACTION = 2.0


def _separator(line: str) -> str:
    return next((mark for mark in ("\t", ";", ",") if mark in line), ",")


def _header(source: InstrumentText) -> tuple[int, list[str], dict[int, float]] | None:
    """Index and cells of the line that names wavelengths, and these by column.

    Numbers alone are a header where the line has words, too; a row of counts has none.
    """
    for index, line in enumerate(source.lines):
        cells = split_cells(line, _separator(line))
        bands = {k: float(match[1]) for k, cell in enumerate(cells) if (match := _BAND.fullmatch(cell))}
        has_text = any(cell and not cell[0].isdigit() for cell in cells)
        if len(bands) >= _MIN_BANDS and has_text and list(bands) == list(range(min(bands), max(bands) + 1)):
            return index, cells, bands
    return None


def _recognises(source: InstrumentText) -> bool:
    if "BEGIN_DATA_FORMAT" in source.text:  # CGATS names its fields so
        return False
    header = _header(source)
    if header is None:
        return False
    steps = np.diff(list(header[2].values()))
    return bool(np.all(steps > 0) or np.all(steps < 0)) or _MAKER.search("\n".join(source.lines[:20])) is not None


def _read(source: InstrumentText) -> InstrumentFile:
    header = _header(source)
    index, names, bands = header if header is not None else (0, [], {})
    separator = _separator(source.lines[index])
    label = next((k for k, cell in enumerate(names) if _NAME.fullmatch(cell)), 0 if 0 not in bands else None)
    text = "\n".join((*source.lines[:index], *(cell for cell in names)))
    unit, quantity, per_cent = _UNIT.search(source.text), quantity_named(text), states_per_cent(text)
    per_cent = per_cent or (is_fraction(quantity) and _IN_PER_CENT.search(text) is not None)
    if unit is not None and not is_fraction(quantity):
        quantity, per_cent = quantity_named(unit[0]) or quantity, False
    elif _RADIANCE_METER.search("\n".join(source.lines[:20])):
        hint = "Export it with its units, or write 'W/(sr m2 nm)' above the header."
        raise InputError(source.at(index + 1), "radiances without a unit", "a unit in the lines above", hint)
    samples: list[tuple[int, list[str]]] = []
    for number, line in enumerate(source.lines[index + 1 :], start=index + 2):
        cells = split_cells(line, separator)
        if not cells:
            continue
        if not max(bands) < len(cells) <= len(names):
            fault, expected = f"{len(cells)} cells", f"{len(names)} as in the header, line {index + 1}"
            raise InputError(source.at(number), fault, expected, "Export the file again.")
        samples.append((number, cells))
    spectra: list[MeasuredSpectrum] = []
    for (number, cells), name in zip(samples, _names([cells for _, cells in samples], label, min(bands)), strict=True):
        decimal = "," if any("," in cells[k] for k in bands) else "."
        rows = [(number, at, decimal_number(cells[k], source.at(number), decimal)) for k, at in bands.items()]
        largest = max(value for _, _, value in rows)
        if unit is None and not is_fraction(quantity) and largest > _LARGEST_FRACTION:
            expected = "the quantity, or the unit, in a line above the header"
            hint = "Write 'Reflectance (%)' above the header, or what else the values are."
            raise InputError(source.at(number), f"values up to {largest:g} of no stated quantity", expected, hint)
        name = name or f"{quantity or 'sample'} {len(spectra) + 1}"
        spectra.append(
            measured_spectrum(
                source,
                name,
                rows,
                quantity=quantity,
                unit="per cent" if per_cent else "" if unit is None else unit[0].strip(),
                per_cent=per_cent,
            )
        )
    return InstrumentFile(READER.name, unique_names(source, spectra))


def _names(rows: list[list[str]], label: int | None, columns: int) -> list[str]:
    """Names of the samples, by their column.

    Where a name repeats, a cell of one of the first ``columns`` stands behind it: a spectrophotometer measures a sample
    twice, with (SCI) and without (SCE) its gloss.
    """
    names = ["" if label is None else cells[label] for cells in rows]
    worded = [k for k in range(columns) if all(cells[k][:1].isalpha() for cells in rows)]
    further = ([" ".join((name, cells[k])) for name, cells in zip(names, rows, strict=True)] for k in worded)
    choices = [names, *further] if all(names) else [names]
    return next((choice for choice in choices if len(set(choice)) == len(choice)), names)


READER = SpectrumReader("sample_rows", "table with a sample in each row", _recognises, _read)
