"""Sekonic C-7000 files, lines such as ``Spectral Data 380[nm],0.0001``."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    SpectrumReader,
    decimal_number,
    last_spectrum,
    measured_spectrum,
)

_SAMPLE = re.compile(r"\s*\"?Spectral Data\s+(\d{3,4})\s*\[nm\]\"?\s*[,;\t](.*)")


def _recognises(source: InstrumentText) -> bool:
    return any(map(_SAMPLE.match, source.lines))


def _read(source: InstrumentText) -> InstrumentFile:
    rows: list[tuple[int, float, float]] = []
    for number, line in enumerate(source.lines, start=1):
        match = _SAMPLE.match(line)
        if match is None:
            continue
        cell = match[2].strip().strip('"')
        rows.append((number, float(match[1]), decimal_number(cell, source.at(number))))
    last, repeated = last_spectrum(rows)  # 5 nm first, then 1 nm
    mode = re.search(r"^\"?Measuring Mode\"?\s*[,;\t]\s*\"?([^\"\n]*)", source.text, re.M)
    if mode and mode[1].strip() and not mode[1].strip().lower().startswith("ambient"):
        at_line = source.text[: mode.start()].count("\n") + 1
        fault, hint = f"the mode '{mode[1].strip()[:40]}'", "Measure a steady light in the mode Ambient."
        raise InputError(source.at(at_line), fault, "Ambient, whose values are irradiances", hint)
    notes = ["The file states no unit; W m^-2 nm^-1 is that of the maker's description."]
    unit = "W m^-2 nm^-1"
    spectrum = measured_spectrum(source, "irradiance", last, quantity="irradiance", unit=unit)
    return InstrumentFile(READER.name, (spectrum,), (*notes, *repeated))


READER = SpectrumReader("sekonic", "Sekonic", _recognises, _read)
