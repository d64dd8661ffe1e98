"""CGATS text files of X-Rite and ArgyllCMS (.txt, .ti3, .sp)."""

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

#: Names of fields with a value at a wavelength in nm.
_BAND = re.compile(
    r"(SPEC_|SPECTRAL_?|SPECTRAL_NM_?|NM_?|R_|SPECTRAL_DEC_?|SPECTRAL_PCT_?)(\d{3,4}(?:\.\d+)?)(NM)?", re.I
)
#: Cell of a line with white space between its cells.
_CELL = re.compile(r'"[^"]*"|\S+')
#: Fields that name a set of data, the most telling first.
_NAMES = ("SAMPLE_NAME", "SAMPLE_ID", "SAMPLEID", "SAMPLE_LOC")
#: By value of MEAS_TYPE (.sp) or DEVICE_CLASS (.ti3) of ArgyllCMS, the quantity.
_QUANTITIES = {
    "REFLECTIVE": "reflectance",
    "TRANSMISSIVE": "transmittance",
    "EMISSION": "emission",
    "AMBIENT": "ambient",
    "EMISSION_FLASH": "emission of a flash",
    "AMBIENT_FLASH": "ambient of a flash",
    "OUTPUT": "reflectance",
    "INPUT": "reflectance",
    "DISPLAY": "emission",
    "EMISINPUT": "emission",
}


def _recognises(source: InstrumentText) -> bool:
    return any(line.strip() == "BEGIN_DATA_FORMAT" for line in source.lines)


def _block(source: InstrumentText, name: str) -> list[tuple[int, list[str]]]:
    """Lines and cells between BEGIN_name and END_name, which occur once."""
    marks = [
        [k for k, line in enumerate(source.lines) if line.strip() == f"{edge}_{name}"] for edge in ("BEGIN", "END")
    ]
    begins, ends = marks
    if len(begins) != 1 or len(ends) != 1 or ends[0] < begins[0]:
        line = (begins or ends or [0])[-1] + 1
        fault = f"{len(begins)} BEGIN_{name} and {len(ends)} END_{name}"
        hint = "Export the file again, or keep one table of it."
        raise InputError(source.at(line), fault, "one of each, in this order", hint)
    rows = []
    for number in range(begins[0] + 2, ends[0] + 1):
        text = source.lines[number - 1]
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        if text.count('"') % 2:
            hint = "Correct the line."
            raise InputError(source.at(number), "a quotation without end", "quotation marks in pairs", hint)
        cells = text.strip().split("\t") if "\t" in text else _CELL.findall(text)
        rows.append((number, [cell.strip().strip('"') for cell in cells]))
    return rows


def _keyword(source: InstrumentText, name: str) -> tuple[int, str]:
    """Line and value of a keyword of the header; line 0 and empty if it is absent."""
    for number, line in enumerate(source.lines, start=1):
        match = re.match(rf'\s*{name}\s+"?([^"#]*)', line)
        if match:
            return number, match[1].strip()
    return 0, ""


def _is_per_cent(source: InstrumentText, fields: list[str], quantity: str) -> bool:
    """Whether values are per cent.

    SPECTRAL_NORM decides, then the names of the fields, then the definition of .ti3 files.
    """
    line, norm = _keyword(source, "SPECTRAL_NORM")
    if norm:
        scale = decimal_number(norm, f"{source.at(line)}, SPECTRAL_NORM")
        allowed = (1.0, 100.0) if quantity in ("reflectance", "transmittance") else (1.0,)
        if scale not in allowed:
            expected = " or ".join(f"{value:g}" for value in allowed)
            hint = "Divide the values by it and write 1."
            raise InputError(source.at(line), f"SPECTRAL_NORM {scale:g}", expected, hint)
        return scale == 100.0
    if any(field.upper().startswith("SPECTRAL_PCT") for field in fields):
        return True
    # ArgyllCMS defines the reflectances of a .ti3 file as per cent.
    return source.text.lstrip().startswith("CTI3") and quantity == "reflectance"


def _read(source: InstrumentText) -> InstrumentFile:
    formats = _block(source, "DATA_FORMAT")
    fields = [cell for _, cells in formats for cell in cells]
    bands = {k: float(match[2]) for k, field in enumerate(fields) if (match := _BAND.fullmatch(field))}
    if not bands:
        line = formats[0][0] if formats else 1
        hint = "Export the file with spectral data."
        raise InputError(source.at(line), "no spectral fields", "fields such as nm380, SPEC_380 or R_380", hint)
    kind = _keyword(source, "MEAS_TYPE")[1] or _keyword(source, "DEVICE_CLASS")[1]
    quantity = _QUANTITIES.get(kind.upper(), "")
    if not quantity and any(re.match(r"SPECTRAL_(PCT|DEC)|R_", fields[k], re.I) for k in bands):
        quantity = "reflectance"
    per_cent = _is_per_cent(source, [fields[k] for k in bands], quantity)
    rows = _block(source, "DATA")
    line, sets = _keyword(source, "NUMBER_OF_SETS")
    if sets and sets != str(len(rows)):
        hint = "The file is truncated, or was edited: export it again."
        raise InputError(source.at(line), f"NUMBER_OF_SETS {sets[:20]}", f"{len(rows)}, the sets of the file", hint)
    for number, cells in rows:
        if len(cells) != len(fields):
            fault, expected = f"{len(cells)} cells", f"{len(fields)}, as in the data format"
            raise InputError(source.at(number), fault, expected, "Export the file again.")
    names = _names(fields, [cells for _, cells in rows])
    spectra = []
    for name, (number, cells) in zip(names, rows, strict=True):
        samples = [(number, at, decimal_number(cells[k], source.at(number))) for k, at in bands.items()]
        spectra.append(
            measured_spectrum(
                source, name, samples, quantity=quantity, unit="per cent" if per_cent else "", per_cent=per_cent
            )
        )
    return InstrumentFile(READER.name, unique_names(source, spectra))


def _names(fields: list[str], rows: list[list[str]]) -> list[str]:
    """Names of the sets.

    From the first field whose cells all differ; the number of the set if there is no such field.
    """
    columns = {field.upper(): k for k, field in enumerate(fields)}
    for field in _NAMES:
        if field in columns:
            names = [cells[columns[field]] for cells in rows]
            if all(names) and len(set(names)) == len(names):
                return names
    return ["value"] if len(rows) == 1 else [str(index) for index in range(1, len(rows) + 1)]


READER = SpectrumReader("cgats", "CGATS (X-Rite, ArgyllCMS)", _recognises, _read)
