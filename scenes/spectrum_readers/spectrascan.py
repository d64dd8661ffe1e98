"""Text of Photo Research PR-650 and PR-655, the answer to their command D5."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._spectrum_reader import InstrumentFile, InstrumentText, SpectrumReader, decimal_number, measured_spectrum

#: Quality code and unit code at the start of the answer, and further numbers.
_STATUS = re.compile(r"\s*(-?\d{4,5})\s*,\s*(\d)\s*(,.*)?")
#: Lines before the answer, at most.
_MAX_PREAMBLE = 20


def _status(source: InstrumentText) -> int | None:
    """Index of the line with the codes; None if there is none."""
    for index, line in enumerate(source.lines[:_MAX_PREAMBLE]):
        match = _STATUS.fullmatch(line)
        if match and match[1].lstrip("-").startswith("0"):
            return index
    return None


def _recognises(source: InstrumentText) -> bool:
    return _status(source) is not None


def _read(source: InstrumentText) -> InstrumentFile:
    index = _status(source) or 0
    match = _STATUS.fullmatch(source.lines[index])
    quality, unit = (int(match[1]), match[2]) if match else (0, "")
    where = source.at(index + 1)
    if quality != 0:
        raise InputError(where, f"the quality code {quality}", "0, a sound measurement", "Measure again.")
    if unit != "1":
        hint = "Set the instrument to SI units and read it again."
        raise InputError(where, f"the unit code {unit}", "1, SI units", hint)
    # the PR-650 writes peak and total on the next line, the PR-655 after the codes
    summary = match[3] if match else None
    first = index + (1 if summary and "," in summary[1:] else 2)
    rows = []
    for number, line in enumerate(source.lines[first:], start=first + 1):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != 2:
            fault = f"'{line.strip()[:40]}'"
            raise InputError(source.at(number), fault, "a wavelength, a comma and a radiance", "Read it again.")
        at, value = (decimal_number(cell, source.at(number)) for cell in cells)
        rows.append((number, at, value))
    unit = "W m^-2 sr^-1 nm^-1"
    spectrum = measured_spectrum(source, "radiance", rows, quantity="radiance", unit=unit)
    return InstrumentFile(READER.name, (spectrum,))


READER = SpectrumReader("spectrascan", "PR-650 or PR-655", _recognises, _read)
