"""JCAMP-DX 4.24 with plain numbers, as spectrophotometers export it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from cboxlab.utils.errors import InputError

from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    MeasuredSpectrum,
    SpectrumReader,
    decimal_number,
    measured_spectrum,
)

_LABEL = re.compile(r"##\s*([^=]*?)\s*=\s*(.*)")
#: A number of a line of data; a sign separates it from the one before.
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?")
#: Factors to nm, by unit of the abscissa.
_LENGTHS = {"NANOMETERS": 1.0, "MICROMETERS": 1000.0, "NM": 1.0}
#: Quantity and whether it is per cent, by unit of the ordinate.
_ORDINATES = {
    "REFLECTANCE": ("reflectance", False),
    "TRANSMITTANCE": ("transmittance", False),
    "% REFLECTANCE": ("reflectance", True),
    "%R": ("reflectance", True),
    "% TRANSMITTANCE": ("transmittance", True),
    "%T": ("transmittance", True),
}
#: Largest deviation of a line's stated abscissa from its number, in steps: abscissas are rounded.
_ROUNDED = 0.5


def _recognises(source: InstrumentText) -> bool:
    return re.search(r"^##\s*JCAMP-?DX\s*=", source.text, re.M | re.I) is not None


def _records(source: InstrumentText) -> dict[str, tuple[int, str]]:
    """Line and text of each labelled record, in lines and without comments."""
    records: dict[str, tuple[int, str]] = {}
    label = ""
    for number, line in enumerate(source.lines, start=1):
        bare = line.split("$$")[0].rstrip()
        if (match := _LABEL.match(bare)) is not None:
            label = re.sub(r"[\s/_-]", "", match[1]).upper()
            if label in records and label not in ("", "END"):
                hint = "Export one spectrum to a file."
                raise InputError(source.at(number), f"##{label} a second time", "one spectrum", hint)
            records[label] = number, match[2]
        elif label:
            records[label] = records[label][0], f"{records[label][1]}\n{bare}"
    return records


def _read(source: InstrumentText) -> InstrumentFile:
    records = _records(source)

    def entry(label: str, default: str | None = None) -> tuple[int, str]:
        if label not in records and default is None:
            raise InputError(source.path, f"no ##{label}", "this record", "Export the spectrum again.")
        number, value = records.get(label, (0, default or ""))
        return number, value.strip()

    line, abscissa = entry("XUNITS")
    if abscissa.upper() not in _LENGTHS:
        hint = "Export it against wavelength."
        raise InputError(source.at(line), f"XUNITS '{abscissa[:40]}'", "NANOMETERS or MICROMETERS", hint)
    line, ordinate = entry("YUNITS")
    if ordinate.upper() not in _ORDINATES:
        hint = "Export reflectance or transmittance."
        raise InputError(source.at(line), f"YUNITS '{ordinate[:40]}'", " or ".join(_ORDINATES), hint)
    factors = [decimal_number(entry(label, "1")[1], str(source.path)) for label in ("XFACTOR", "YFACTOR")]
    start, text = next((records[label] for label in ("XYDATA", "XYPOINTS") if label in records), (0, ""))
    form, *lines = text.split("\n")
    form = form.replace(" ", "").upper()
    numbered = [(start + k, row) for k, row in enumerate(lines, start=1) if row.strip()]
    if form == "(XY..XY)":
        rows = _pairs(source, numbered, factors)
    elif form == "(X++(Y..Y))":
        rows = _steps(source, numbered, factors, entry)
    else:
        where = source.at(start) if start else source.path
        raise InputError(where, f"data '{form[:40]}'", "##XYDATA=(X++(Y..Y)) or (XY..XY)", "Export it as XY.")
    count = decimal_number(entry("NPOINTS", str(len(rows)))[1], str(source.path))
    if count != len(rows):
        hint = "The file is truncated: export it again."
        raise InputError(source.path, f"{len(rows)} points", f"{count:g} by ##NPOINTS", hint)
    return InstrumentFile(READER.name, (_spectrum(source, rows, _LENGTHS[abscissa.upper()], ordinate),))


def _spectrum(
    source: InstrumentText, rows: Sequence[tuple[int, float, float]], factor: float, ordinate: str
) -> MeasuredSpectrum:
    quantity, per_cent = _ORDINATES[ordinate.upper()]
    samples = [(number, at * factor, value) for number, at, value in rows]
    return measured_spectrum(source, quantity, samples, quantity=quantity, unit=ordinate.lower(), per_cent=per_cent)


def _values(source: InstrumentText, number: int, line: str) -> list[float]:
    """Numbers of a line; packed ones have letters in place of digits."""
    if _NUMBER.sub("", line).strip(" \t,;"):
        hint = "Export it without compression (AFFN), or as a table of text."
        raise InputError(source.at(number), f"'{line.strip()[:40]}'", "plain numbers", hint)
    return [float(text) for text in _NUMBER.findall(line)]


def _pairs(
    source: InstrumentText, lines: Sequence[tuple[int, str]], factors: Sequence[float]
) -> list[tuple[int, float, float]]:
    """Line, abscissa and ordinate of points in pairs."""
    rows = []
    for number, line in lines:
        values = _values(source, number, line)
        if len(values) % 2:
            raise InputError(source.at(number), f"{len(values)} numbers", "pairs", "Export the spectrum again.")
        pairs = np.reshape(values, (-1, 2)) * factors
        rows += [(number, float(x), float(y)) for x, y in pairs]
    return rows


def _steps(
    source: InstrumentText,
    lines: Sequence[tuple[int, str]],
    factors: Sequence[float],
    entry: Callable[[str], tuple[int, str]],
) -> list[tuple[int, float, float]]:
    """Line, abscissa and ordinate of points in equal steps, each line with its first abscissa."""
    first, last, count = (decimal_number(entry(k)[1], str(source.path)) for k in ("FIRSTX", "LASTX", "NPOINTS"))
    step = (last - first) / max(count - 1, 1)
    rows: list[tuple[int, float, float]] = []
    for number, line in lines:
        at, *values = _values(source, number, line)
        expected = first + step * len(rows)
        if abs(at * factors[0] - expected) > _ROUNDED * abs(step):
            fault, hint = f"the abscissa {at * factors[0]:g}", "The file is damaged: export it again."
            raise InputError(source.at(number), fault, f"{expected:g} by the points before", hint)
        rows += [(number, first + step * (len(rows) + k), y * factors[1]) for k, y in enumerate(values)]
    return rows


READER = SpectrumReader("jcamp", "JCAMP-DX", _recognises, _read)
