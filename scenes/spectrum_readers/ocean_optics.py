"""Ocean Optics text of SpectraSuite, OceanView and Jaz, which names its columns by letters."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._delimited import numeric_rows
from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    SpectrumReader,
    doubtful_values,
    measured_spectrum,
    quantity_named,
)

_BEGIN = re.compile(r"\s*>>>>>\s*Begin (Processed )?Spectral Data\s*<<<<<\s*")
#: Unit of a processed spectrum in the line of its mode: Absolute Irradiance, uW/cm^2/nm.
_UNIT = re.compile(r"[uµμm]?W/[^,;()\s]*nm")
_END = re.compile(r"\s*>>>>>\s*End (Processed )?Spectral Data\s*<<<<<\s*")


def _recognises(source: InstrumentText) -> bool:
    return any(map(_BEGIN.fullmatch, source.lines))


def _read(source: InstrumentText) -> InstrumentFile:
    begins = [k for k, line in enumerate(source.lines) if _BEGIN.fullmatch(line)]
    ends = [k for k, line in enumerate(source.lines) if _END.fullmatch(line)]
    if len(begins) != 1 or len(ends) > 1 or (ends and ends[0] < begins[0]):
        fault = f"{len(begins)} marks 'Begin Spectral Data' and {len(ends)} marks 'End'"
        hint = "Export one spectrum to a file."
        raise InputError(source.at(begins[-1] + 1), fault, "one, and at most one after it", hint)
    begin, end = begins[0], ends[0] if ends else len(source.lines)
    header = {
        key.strip().lower(): (number, value.strip())
        for number, line in enumerate(source.lines[:begin], start=1)
        for key, colon, value in [line.partition(":")]
        if colon
    }
    line, axis = header.get("xaxis mode", (0, ""))
    if axis and axis.lower() not in ("wavelengths", "wavelength"):
        hint = "Export it with wavelengths in nm."
        raise InputError(source.at(line), f"XAxis mode '{axis[:40]}'", "Wavelengths", hint)
    lines = [
        (number, text) for number, text in enumerate(source.lines[begin + 1 : end], start=begin + 2) if text.strip()
    ]
    names = lines[0][1].split() if lines else []
    if names[:1] == ["W"] and len(set(names)) == len(names) > 1:  # Jaz: wavelength, dark, sample, reference, processed
        lines = lines[1:]
    else:
        names = ["W", "value"]
    rows = numeric_rows(source, lines, len(names))
    pixels = next(((n, v) for key, (n, v) in header.items() if key.startswith("number of pixels")), None)
    if pixels and pixels[1] != str(len(rows)):
        fault, hint = f"{pixels[1][:20]} pixels by the header", "The file is truncated: export it again."
        raise InputError(source.at(pixels[0]), fault, f"{len(rows)}, the rows of the file", hint)
    mode = next((value for key, (_, value) in header.items() if key in ("processing", "yaxis mode")), "")
    unit = (_UNIT.search(mode) or [""])[0]
    quantity = quantity_named(mode) if unit else ""
    spectra = tuple(
        measured_spectrum(
            source,
            name,
            [(number, values[0], values[k]) for number, values in rows],
            quantity=quantity if name in ("value", "P") else "",
            unit=unit if name in ("value", "P") else "",
        )
        for k, name in enumerate(names[1:], start=1)
    )
    notes = [] if unit else ["The file states neither quantity nor unit of its values."]
    return InstrumentFile(READER.name, spectra, (*notes, *doubtful_values(spectra)))


READER = SpectrumReader("ocean_optics", "Ocean Optics text", _recognises, _read)
