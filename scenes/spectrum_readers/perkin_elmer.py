"""PerkinElmer ASCII of UV WinLab: units of the axes in section #GR, rows in section #DATA."""

from __future__ import annotations

import re

from cboxlab.utils.errors import InputError

from ._delimited import numeric_rows
from ._spectrum_reader import InstrumentFile, InstrumentText, SpectrumReader, measured_spectrum

#: First words of a file; earlier spectrometers leave the technique out.
_MARK = re.compile(r"PE \w+ +(SUBTECH +)?SPECTRUM +ASCII")
#: Quantities by the unit of the ordinate; all are in per cent.
_QUANTITIES = {"%R": "reflectance", "%T": "transmittance"}


def _recognises(source: InstrumentText) -> bool:
    return _MARK.match(source.lines[0]) is not None


def _section(source: InstrumentText, name: str) -> int:
    """Index of the line after a section's mark."""
    marks = [index for index, line in enumerate(source.lines) if line.strip() == name]
    if len(marks) != 1:
        fault = f"{len(marks)} sections {name}"
        raise InputError(source.path, fault, "one of each, #GR and #DATA", "Export the spectrum again.")
    return marks[0] + 1


def _read(source: InstrumentText) -> InstrumentFile:
    axes, start = _section(source, "#GR"), _section(source, "#DATA")
    abscissa, ordinate = (line.strip() for line in source.lines[axes : axes + 2])
    if abscissa.lower() != "nm":
        raise InputError(source.at(axes + 1), f"the axis '{abscissa[:40]}'", "nm", "Export it against wavelength.")
    if ordinate.upper() not in _QUANTITIES:
        fault, hint = f"the ordinate '{ordinate[:40]}'", "Export reflectance or transmittance."
        raise InputError(source.at(axes + 2), fault, "%R or %T", hint)
    lines = [(n, text) for n, text in enumerate(source.lines[start:], start=start + 1) if text.strip()]
    samples = [(number, values[0], values[1]) for number, values in numeric_rows(source, lines, 2)]
    quantity = _QUANTITIES[ordinate.upper()]
    spectrum = measured_spectrum(source, quantity, samples, quantity=quantity, unit="per cent", per_cent=True)
    return InstrumentFile(READER.name, (spectrum,))


READER = SpectrumReader("perkin_elmer", "PerkinElmer ASCII", _recognises, _read)
