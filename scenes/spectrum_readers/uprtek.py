"""UPRtek files: lines such as ``380nm<tab>0.03``, irradiance in mW m^-2 nm^-1."""

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

_SAMPLE = re.compile(r"(\d{3,4}(?:\.\d+)?)\s*(?:nm|\[nm\])([\t,;])(.*)")


def _recognises(source: InstrumentText) -> bool:
    return re.search(r"^Model Name[\t,;]", source.text, re.M) is not None and any(map(_SAMPLE.match, source.lines))


def _read(source: InstrumentText) -> InstrumentFile:
    rows: list[tuple[int, float, float]] = []
    for number, line in enumerate(source.lines, start=1):
        match = _SAMPLE.match(line)
        if match is None:
            continue
        cells = match[3].rstrip(match[2]).split(match[2])
        if len(cells) != 1:
            fault, hint = f"{len(cells)} values at one wavelength", "Export one measurement to a file."
            raise InputError(source.at(number), fault, "one", hint)
        rows.append((number, float(match[1]), decimal_number(cells[0], source.at(number))))
    last, repeated = last_spectrum(rows)
    model = re.search(r"^Model Name[\t,;](.*)$", source.text, re.M)
    notes = [f"Model: {model[1].strip()[:60]}."] if model else []
    notes.append("The file states no unit; mW m^-2 nm^-1 is that of the maker's description.")
    unit = "mW m^-2 nm^-1"
    spectrum = measured_spectrum(source, "irradiance", last, quantity="irradiance", unit=unit)
    return InstrumentFile(READER.name, (spectrum,), (*notes, *repeated))


READER = SpectrumReader("uprtek", "UPRtek", _recognises, _read)
