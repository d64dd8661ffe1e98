"""Tables of spectrophotometers and spreadsheets: a header with units, then rows of numbers."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from cboxlab.utils.errors import InputError

from ._delimited import NumberTable, find_table, split_cells
from ._spectrum_reader import (
    NOT_LINEAR,
    InstrumentFile,
    InstrumentText,
    MeasuredSpectrum,
    SpectrumReader,
    doubtful_values,
    fitting_units,
    is_fraction,
    measured_spectrum,
    quantity_named,
    states_per_cent,
    unique_names,
)

#: Factors to nm, by pattern of a unit in a header.
_LENGTHS = {
    r"(?<![a-z0-9])(nm\.?|nanomet(er|re)s?)(?![a-z0-9])": 1.0,
    r"(?<![a-z0-9])(um|[µμ]m|microns?|micromet(er|re)s?)(?![a-z0-9])": 1000.0,
    r"(?<![a-z0-9])([åÅ]|å|angstr[oö]ms?|ångstr[oö]ms?)(?![a-z0-9])": 0.1,
}
#: Header of a column of wavelengths.
_WAVELENGTH = re.compile(r"wave\s*-?_?length|wellenl|longueur d.onde|(?<![a-z])wv?l(?![a-z])|(?<!\()(?:λ|lambda)", re.I)
#: The word in full.
_WAVELENGTH_WORD = re.compile(rf"\w*(?:{_WAVELENGTH.pattern})\w*", re.I)
#: Letters next to it, which may be a unit.
_FURTHER_LETTERS = re.compile(r"[^\W\d_]")
#: Header of a column of wavenumbers, energies or frequencies.
_OTHER_AXIS = re.compile(r"wave\s*-?_?number|cm\s*(\^|\*\*)?\s*[-−⁻]\s*[1¹]|1/cm|(?<![a-z])(ev|thz|hz)(?![a-z])", re.I)
#: Header of a column of wavenumbers in 1/cm.
_PER_CM = re.compile(r"cm\s*(\^|\*\*)?\s*[-−⁻]\s*[1¹]|1/cm", re.I)
#: In place of a factor to nm, for wavenumbers: values per wavelength and per wavenumber differ, fractions do not.
_WAVENUMBER = -1.0
#: Nanometres in a centimetre.
_NM_PER_CM = 1e7
#: First cell of a header that is no name of wavelengths, and has their unit: "Wvlgth nm", "x [um]".
_ENDS_IN_LENGTH = re.compile(r"[\s_([](nm|um|[µμ]m|[åÅ])[\])]?$", re.I)
#: Unit in brackets, or a cell that is a radiometric unit itself.
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?)[\])]")
#: Unit behind the slash by which it divides a quantity, such as "radiance/W/(sr m2 nm)".
_AFTER_SLASH = re.compile(r"\w\s*/\s*([uµμm]?W\s*/.*nm.*)$")
_RADIOMETRIC = re.compile(
    r"[uµμm]?w(?:atts?)?\W.*nm.*|[uµμm]?w\s?m.*|counts?|a\.?u\.?|rel(ative)?\.?|arb.*|1|abs\.?|%\s*[rt]?|[rt]\s*%", re.I
)
#: Largest absorbance that spectrophotometers state.
_LARGEST_ABSORBANCE = 10.0
#: Texts of other kinds, by the beginning of a line.
_OTHER_KINDS = {r"IESNA|TILT=": "a photometric file (IES LM-63): candela over angles, without wavelengths"}


def _length_factor(text: str) -> float | None:
    """Factor from a stated unit of length to nm; None for no unit or two."""
    factors = {factor for pattern, factor in _LENGTHS.items() if re.search(pattern, text, re.I)}
    return factors.pop() if len(factors) == 1 else None


def _recognises(source: InstrumentText) -> bool:
    return False  # the reader of what no other reader recognises


def _cells(line: str, separator: str, width: int) -> list[str]:
    """Cells of a header line.

    With white space as separator a unit in brackets stays with its column.
    """
    if separator != " ":
        return split_cells(line, separator)
    wide = [cell for cell in re.split(r"\s{2,}|\t", line.strip()) if cell]
    if len(wide) == width:
        return wide
    return re.sub(r"\s+(?=[\[(])", "\0", line.strip()).replace("\0", "_").split()


def _header(source: InstrumentText, table: NumberTable) -> list[list[str]]:
    """Cells of the header rows, from the top.

    They are the lines directly above the table with as many cells as its rows, from the first that names wavelengths.
    A row above it counts where several columns are wavelengths, whose samples it names, or where that row has units.
    """
    width = len(table.rows[0][1])

    def names_wavelengths(cells: list[str]) -> bool:
        return any(map(_is_axis, cells)) or _ENDS_IN_LENGTH.search(cells[0]) is not None

    for lines in (table.header, table.comments):
        rows: list[list[str]] = []
        below = 0
        for number, line in reversed(lines[-3:]):
            cells = _cells(line, table.style.separator, width)
            may_lack_one = table.style.separator != " " and (rows or width > 2)
            if not (len(cells) == width or (may_lack_one and len(cells) == width - 1)):
                break
            if rows and number != below - 1 and names_wavelengths(rows[0]):
                break  # above an empty line stands what belongs to the measurement
            rows.insert(0, cells + [""] * (width - len(cells)))
            below = number
        top = next((index for index, row in enumerate(rows) if names_wavelengths(row)), None)
        if top is not None:
            if sum(map(_is_axis, rows[top])) > 1 or all(_is_unit(cell) for cell in rows[top] if cell):
                return rows
            return rows[top:]
    title = "\n".join(line for _, line in (*table.header, *table.comments))
    axes = [
        re.search(rf"^\W*{axis}[\s_-]?(?:axis|data)?[\s_-]?units?\W*?[,;:=\t]?\s*(\w.*|%.*)$", title, re.M | re.I)
        for axis in "xy"
    ]
    if width == 2 and axes[0] and axes[1]:  # JASCO, Thorlabs and ECOSTRESS state the columns above the table
        return [[f"wavelength ({axes[0][1].strip()})", axes[1][1].strip()]]
    unit = next((line.strip().strip('"') for _, line in reversed(table.header) if _is_unit(line.strip('" '))), "")
    if width == 2 and quantity_named(unit):  # StellarNet states the unit of the values alone
        return [["wavelength", unit]]
    if table.style.has_unit and width == 2:
        return [["wavelength (nm)", "value"]]
    first, cells = table.rows[0][0], split_cells(table.header[-1][1], ",") if table.header else []
    if table.style.separator == "," and len(cells) < width and cells and names_wavelengths(cells):
        hint = "If the comma is separator and decimal mark, export with semicolons or tabs, or with decimal points."
        raise InputError(source.at(first), f"{width} cells", f"{len(cells)}, as the header above", hint)
    ends = f"from {table.rows[0][1][0]:g} to {table.rows[-1][1][0]:g}"
    hint = (
        f"Its first column runs {ends}. Write a header such as 'wavelength_nm' or 'wavenumber (1/cm)' and a name for "
    )
    hint += "each column, separated as the rows are."
    expected = f"a header of {width} cells with the wavelength and its unit above it"
    raise InputError(source.at(first), "a table without a header", expected, hint)


def _is_axis(text: str) -> bool:
    """Whether a header is that of wavelengths (or of another spectral axis)."""
    bare = text.strip().strip("[]().").lower()
    return bool(_WAVELENGTH.search(text) or _OTHER_AXIS.search(text) or bare in ("nm", "um", "µm", "μm", "å", "å"))


def _is_unit(text: str) -> bool:
    """Whether a header is nothing but a unit."""
    bare = text.strip().strip("[]() ")
    return bool(_RADIOMETRIC.fullmatch(bare)) or any(re.fullmatch(unit, bare, re.I) for unit in _LENGTHS)


def _axis_factor(
    source: InstrumentText, text: str, preamble: str, numbers: list[float], *, is_dimensionless: bool
) -> float:
    """Factor to nm of a column of wavelengths; ``_WAVENUMBER`` for wavenumbers of fractions.

    Without a stated unit it is the only one in which the numbers are light.
    """
    if _PER_CM.search(text) and is_dimensionless:
        return _WAVENUMBER
    if _OTHER_AXIS.search(text):
        hint = "Export the table against wavelength: the bands of a wavenumber are not those of a wavelength."
        raise InputError(source.path, f"the axis '{text[:60]}'", "wavelengths in nm, um or Angstrom", hint)
    factor = _length_factor(text.replace("_", " "))
    if factor is None:
        lines = re.findall(r"^.*(?:x\s?-?units?|wavelength|x\s?-?axis).*$", preamble, re.M | re.I)
        factor = _length_factor(" ".join(lines).replace("_", " "))
    if (
        factor is None
        and not _FURTHER_LETTERS.search(_WAVELENGTH_WORD.sub("", text))
        and len(fitting := fitting_units(numbers)) == 1
    ):
        (factor,) = fitting.values()
    if factor is None:
        hint = "Write the unit into the header, such as 'Wavelength (nm)'."
        fault = f"'{text[:60]}', wavelengths without a unit"
        raise InputError(source.path, fault, "a unit: nm, um or Angstrom", hint)
    return factor


def _unusable(text: str) -> str:
    """Reason to leave a column out of a file that has others; empty for none."""
    quantity = quantity_named(text)
    if quantity in NOT_LINEAR:
        return f"{quantity} is not linear in the light"
    return "it does not say of what it is per cent" if states_per_cent(text) and not is_fraction(quantity) else ""


def _counts_rows(table: NumberTable, column: int) -> bool:
    """Whether a column holds whole numbers that rise by one, which count the rows."""
    numbers = [values[column] for _, values in table.rows]
    return all(number == numbers[0] + index for index, number in enumerate(numbers)) and numbers[0] in (0, 1)


def _unit(cells: list[str]) -> str:
    """Unit of a column, as its header states it; empty for none."""
    for cell in reversed(cells):
        if _RADIOMETRIC.fullmatch(cell.strip("[]() ")):
            return cell.strip("[] ") if cell.startswith("[") else cell
        if match := _AFTER_SLASH.search(cell):
            return match[1].strip()
        if bracketed := [text.strip() for text in _BRACKETS.findall(cell)]:
            return next((text for text in bracketed if _RADIOMETRIC.fullmatch(text)), bracketed[0])
    return ""


def _name(cells: list[str], sample: str) -> str:
    """Name of a column: the uppermost text that is no unit."""
    texts = [cell for cell in (*cells[:-1], sample, cells[-1]) if cell]
    return next((cell for cell in texts if not _RADIOMETRIC.fullmatch(cell.strip("[]() "))), texts[0] if texts else "")


def _read(source: InstrumentText) -> InstrumentFile:
    if source.text.lstrip().startswith("<"):
        if re.search(r"<(!doctype )?html", source.text[:1000], re.I):
            raise InputError(source.path, "a web page (HTML)", "a file of spectra", "Download the file itself.")
        hint = "Export the spectrum as CxF3, TM-27-14 or text."
        raise InputError(source.path, "XML or HTML of another kind", "CxF3 or IES TM-27-14", hint)
    for start, kind in _OTHER_KINDS.items():
        if re.search(rf"^(?:{start})", source.text, re.M):
            raise InputError(source.path, kind, "a spectrum", "Export the spectrum, such as IES TM-27-14 or CSV.")
    table = find_table(source)
    header = _header(source, table)
    columns = [[row[k] for row in header] for k in range(len(header[0]))]
    axes = [k for k, cells in enumerate(columns) if any(map(_is_axis, cells))]
    if not axes and _ENDS_IN_LENGTH.search(" ".join(columns[0])):
        axes = [0]
    waves = [k for k in axes if not _OTHER_AXIS.search(" ".join(columns[k]))]
    axes = [k for k in axes if k in waves or not {k - 1, k + 1} & set(waves)]
    spare = [k for k, cells in enumerate(columns) if k not in axes and any(map(_is_axis, cells))]
    counters = axes[0] if axes and all(k in spare or _counts_rows(table, k) for k in range(axes[0])) else 0
    if counters:  # numbers of pixels, and wavenumbers of the same samples
        columns, axes, spare = columns[counters:], [k - counters for k in axes], [k - counters for k in spare]
        table = replace(table, rows=[(number, values[counters:]) for number, values in table.rows])
    if not axes or axes[0] != 0:
        raise InputError(source.path, f"'{columns[0][-1][:40]}' first", "the wavelength as first column", "Move it.")
    preamble = "\n".join(line for _, line in (*table.header[: len(table.header) - len(header)], *table.comments))
    plain = table.style.separator == "," and header[-1][0] == "wavelength_nm"  # the project's own tables
    spectra: list[MeasuredSpectrum] = []
    notes: list[str] = []
    factors = set()
    values = [cells for k, cells in enumerate(columns) if k not in axes and k not in spare]
    only_fractions = bool(values) and all(
        is_fraction(quantity_named(" ".join(cells)) or quantity_named(_title(preamble))) for cells in values
    )
    none_usable = all(_unusable(" ".join(cells)) for cells in values)
    factor, sample, axis = 1.0, "", 0
    for k, cells in enumerate(columns):
        if k in axes:
            axis, sample = k, next((cell for cell in cells if cell and not _is_axis(cell)), "")
            sample = "" if _length_factor(sample) else sample
            numbers = [row[k] for _, row in table.rows if not math.isnan(row[k])]
            factor = _axis_factor(source, " ".join(cells), preamble, numbers, is_dimensionless=only_fractions)
            factors.add(factor)
            continue
        reason = _unusable(" ".join(cells))
        if k in spare or (reason and not (plain or none_usable)):
            notes += [f"Column '{_name(cells, sample)[:60]}' is left out: {reason}."] if reason else []
            continue
        if not plain and len(values) == 1:
            _require_no_symbol(source, cells, [row[k] for _, row in table.rows])
        spectra.append(_column(source, table, (axis, k), factor, cells, sample, None if plain else preamble))
    if plain:
        return InstrumentFile("plain CSV", unique_names(source, spectra), ("Values as they stand in the file.",))
    notes += [f"Wavelengths times {factor:g}, to nm." for factor in sorted(factors - {1.0, _WAVENUMBER})]
    notes += ["Wavelengths from wavenumbers, 1e7 nm over their value in 1/cm."] if _WAVENUMBER in factors else []
    notes += doubtful_values(spectra)
    notes += ["Values in per cent, by the sign in each cell, as fractions."] if table.from_per_cent else []
    first, second = (values[0] for _, values in table.rows[:2])
    if first > second:
        notes.append("Wavelengths descend in the file.")
    separators = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "white space"}
    mark = "comma" if table.style.decimal == "," else "point"
    notes.append(f"Columns separated by {separators[table.style.separator]}, decimal {mark}.")
    return InstrumentFile(READER.name, unique_names(source, spectra), tuple(notes))


def _in_nm(x: float, factor: float) -> float:
    """A wavelength in nm, from the axis times its factor, or from a wavenumber in 1/cm."""
    return factor * x if factor != _WAVENUMBER else (_NM_PER_CM / x if x > 0 else 0.0)


def _column(
    source: InstrumentText,
    table: NumberTable,
    indices: tuple[int, int],
    factor: float,
    cells: list[str],
    sample: str,
    preamble: str | None,
) -> MeasuredSpectrum:
    """Spectrum of one column; ``indices`` are those of its wavelengths and of its values.

    Without a ``preamble`` the values are taken as they are, whatever the header says of per cent.
    """
    axis, index = indices
    rows = [(number, values[axis], values[index]) for number, values in table.rows]
    rows = [row for row in rows if not (math.isnan(row[1]) and math.isnan(row[2]))]
    for number, wavelength, value in rows:
        if math.isnan(wavelength) or math.isnan(value):
            fault, expected = f"an empty cell in '{_name(cells, sample)[:40]}'", "finite numbers"
            raise InputError(source.at(number), fault, expected, "Remove or correct the row.")
    rows = [(number, _in_nm(x, factor), value) for number, x, value in rows]
    if preamble is None:
        return measured_spectrum(source, _name(cells, sample), rows)
    text = " ".join(cells)
    per_cent = states_per_cent(text) and not table.from_per_cent
    quantity = quantity_named(text) or quantity_named(_title(preamble))
    if quantity in NOT_LINEAR:
        hint = "Export reflectance, transmittance or a linear scale."
        raise InputError(source.path, f"{quantity} in '{text[:40]}'", "a quantity linear in the light", hint)
    unit = "per cent" if per_cent else _unit(cells)
    return measured_spectrum(source, _name(cells, sample), rows, quantity=quantity, unit=unit, per_cent=per_cent)


def _require_no_symbol(source: InstrumentText, cells: list[str], values: list[float]) -> None:
    """Require that the only column is not A, n or k: absorbance, refractive index."""
    name = cells[-1].strip()
    if name not in ("A", "n", "k") or max(values) > _LARGEST_ABSORBANCE:
        return
    meaning = "absorbance" if name == "A" else "a refractive index"
    hint = "Export reflectance, transmittance or radiance; if it is one of them, name the column so."
    raise InputError(source.path, f"the column '{name}', the symbol of {meaning}", "a quantity of light", hint)


def _title(preamble: str) -> str:
    """Lines above the header that state the measured quantity of all columns."""
    line = r"^.*(?:y\s?-?units?|y\s?-?mode|mode|quantity|y\s?-?axis|data type).*$"
    return " ".join(re.findall(line, preamble, re.M | re.I))


READER = SpectrumReader("table", "table with a header", _recognises, _read)
