"""QTX of X-Rite Color iQC: sections of samples with a list of values each."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    SpectrumReader,
    decimal_number,
    measured_spectrum,
    unique_names,
)

#: Section of one sample.
_SECTION = re.compile(r"\[(?:STANDARD|BATCH)_DATA\b.*\]", re.I)
#: Quantity and suffix of the keys of its list, by the key of the list; all are in per cent.
_LISTS = {"R": ("reflectance", "REFL"), "T": ("transmittance", "TRAN")}


def _recognises(source: InstrumentText) -> bool:
    return any(_SECTION.match(line.strip()) for line in source.lines)


def _read(source: InstrumentText) -> InstrumentFile:
    spectra, number_of_section = [], 0
    sections: dict[int, dict[str, tuple[int, str]]] = {}
    for number, line in enumerate(source.lines, start=1):
        if _SECTION.match(line.strip()):
            number_of_section = number
            sections[number] = {}
        elif number_of_section and "=" in line:
            key, _, value = line.partition("=")
            bare = key.strip().upper().partition("_")[2]
            sections[number_of_section][bare] = number, value.strip().strip(",")
    for start, keys in sections.items():
        for key, (quantity, stem) in _LISTS.items():
            if key not in keys:
                continue
            facts = [keys.get(f"{stem}{name}", (start, "")) for name in ("POINTS", "LOW", "INTERVAL")]
            points, low, step = (decimal_number(text, source.at(at)) for at, text in facts)
            at, text = keys[key]
            values = [decimal_number(cell, source.at(at)) for cell in text.split(",")]
            if len(values) != points:
                fault, expected = f"{len(values)} values", f"{points:g} by {stem}POINTS"
                raise InputError(source.at(at), fault, expected, "A value is missing or spare: export the file again.")
            rows = [(at, low + step * k, value) for k, value in enumerate(values)]
            name = keys.get("NAME", (0, ""))[1]
            spectra.append(measured_spectrum(source, name, rows, quantity=quantity, unit="per cent", per_cent=True))
    return InstrumentFile(READER.name, unique_names(source, spectra))


READER = SpectrumReader("qtx", "QTX (X-Rite Color iQC)", _recognises, _read)
