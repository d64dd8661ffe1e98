"""Tables of numbers in text. Their rows decide separator and decimal mark."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from cboxlab.utils.errors import InputError

from ._spectrum_reader import LONGEST_NM, InstrumentText, decimal_number

__all__ = ["NumberTable", "Style", "find_table", "numeric_rows", "split_cells"]

#: Number of any style, as the first cell of a row.
_NUMBER_LIKE = re.compile(r"[+-]?(\d+([.,]\d+)*\.?|\.\d+)([eE][+-]?\d{1,4})?")
#: Number with a comma that may separate thousands.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
#: Starts of comment lines.
_COMMENTS = ("#", "//", "!", '"#')


@dataclass(frozen=True)
class Style:
    """Spelling of a table."""

    #: Separator of cells: a tab, ";", "," or " " for white space.
    separator: str
    #: Decimal mark, "." or ",".
    decimal: str
    #: Whether the first cell of a row has its unit: 380nm, 380[nm].
    has_unit: bool = False


#: Spellings of tables. Between quotation marks a comma may be the decimal mark of cells that commas separate.
_STYLES = (
    Style("\t", "."),
    Style("\t", ","),
    Style(";", "."),
    Style(";", ","),
    Style(",", "."),
    Style(",", ","),
    Style(" ", "."),
    Style(" ", ","),
    Style("\t", ".", has_unit=True),
    Style("\t", ",", has_unit=True),
    Style(";", ".", has_unit=True),
    Style(";", ",", has_unit=True),
    Style(",", ".", has_unit=True),
    Style(" ", ".", has_unit=True),
)
#: A wavelength with its unit.
_WITH_UNIT = re.compile(r"(\d+(?:[.,]\d+)?)\s*(?:nm|\[nm\]|\(nm\))", re.I)
#: The sign of per cent behind a number.
_PER_CENT = re.compile(r"(?<=[\d.,])\s*%")
#: The same behind the first number of a line, which is a wavelength.
_PER_CENT_FIRST = re.compile(r"[\s\"]*\d+(?:\.\d+)?\s*%")
#: Empty cells at the beginning of a line.
_EMPTY_CELLS = re.compile(r"(?:[ \t]*[,;]|\t)+")


@dataclass(frozen=True)
class NumberTable:
    """Rows of numbers of a file, and the lines before them."""

    #: Spelling of the table.
    style: Style
    #: Line and numbers of each row, as many in each; nan for a pair of cells of a trace that has ended.
    rows: list[tuple[int, list[float]]]
    #: Line and text of the lines before the first row that are not blank and no comments.
    header: list[tuple[int, str]]
    #: Line and text of the comments before the first row, without their mark.
    comments: list[tuple[int, str]]
    #: Whether each value had a sign of per cent in its cell, and is a fraction here.
    from_per_cent: bool = False


def split_cells(line: str, separator: str) -> list[str]:
    """Cells of a line, without quotation marks and without empty cells at its end.

    Parameters
    ----------
    line
        The line.
    separator
        As in `Style`.

    Returns
    -------
    list[str]
        The cells, without white space around.
    """
    if separator == " ":
        cells = line.split()
    else:
        try:
            cells = next(csv.reader([line], delimiter=separator), [])
        except csv.Error:
            cells = line.split(separator)
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _numbers(line: str, style: Style) -> list[float] | None:
    """Numbers of a row; None for a line with other cells, or fewer than two."""
    if style.separator != " " and style.separator not in line:
        return None
    cells = split_cells(line, style.separator)
    if len(cells) < 2:
        return None
    if style.has_unit:
        if (first := _WITH_UNIT.fullmatch(cells[0])) is None:
            return None
        cells[0] = first[1]
    try:
        return [decimal_number(cell, "", style.decimal) for cell in cells]
    except InputError:
        return None


def _style(source: InstrumentText, lines: Sequence[tuple[int, str]]) -> tuple[Style, dict[int, list[float]]]:
    """The spelling in which most lines are rows of numbers, and these rows by line."""
    best: tuple[Style, dict[int, list[float]]] = (_STYLES[0], {})
    for style in _STYLES:
        rows = {number: cells for number, line in lines if (cells := _numbers(line, style)) is not None}
        if len(rows) > len(best[1]):
            best = style, rows
        elif rows and len(rows) == len(best[1]) and rows != best[1]:
            where = source.at(next(iter(rows)))
            fault = "rows that can be read with two separators or decimal marks"
            hint = "Save the table with semicolons or tabs between its columns."
            raise InputError(where, fault, "one reading", hint)
    if best[0].decimal == ",":
        table = [split_cells(line, best[0].separator) for number, line in lines if number in best[1]]
        texts = [text for cells in table for text in cells if "," in text]
        # 400,000 in the first column is no wavelength of 400000 nm
        far = any("," in cells[0] and float(cells[0].replace(",", "")) > LONGEST_NM for cells in table)
        if texts and not far and all(_THOUSANDS.fullmatch(text) for text in texts):
            fault = f"'{texts[0]}', a decimal comma or a separator of thousands"
            hint = "Write decimal points, and no separators of thousands."
            raise InputError(source.at(next(iter(best[1]))), fault, "numbers that can be read in one way", hint)
    return best


def _without_empty_columns(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """The lines without the empty cells with which more than half of them begin."""
    starts = [match[0] for _, line in lines if (match := _EMPTY_CELLS.match(line))]
    if 2 * len(starts) <= len(lines):
        return lines
    common = min(starts, key=len)
    return [(number, line.removeprefix(common)) for number, line in lines]


def _without_blank_columns(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """The lines without columns that are blank in all rows, whatever their header."""
    for separator in "\t;,":
        cells = {number: split_cells(line, separator) for number, line in lines}
        width = Counter(map(len, cells.values())).most_common(1)[0][0] if cells else 0
        body = [row for row in cells.values() if len(row) == width]
        rows = [row for row in body if _NUMBER_LIKE.fullmatch(row[0])] if width > 2 else []
        blank = {k for k in range(width) if rows and not any(row[k] for row in rows)}
        if blank and len(blank) < width - 1:
            return [
                (n, separator.join(f'"{cell}"' for k, cell in enumerate(cells[n]) if k not in blank))
                if len(cells[n]) == width
                else (n, line)
                for n, line in lines
            ]
    return lines


def numeric_rows(
    source: InstrumentText, lines: Sequence[tuple[int, str]], columns: int
) -> list[tuple[int, list[float]]]:
    """Rows of lines that are all rows of numbers.

    Parameters
    ----------
    source
        The file.
    lines
        Line numbers and lines.
    columns
        Number of cells of each line.

    Returns
    -------
    list[tuple[int, list[float]]]
        Line and numbers of each row.

    Raises
    ------
    InputError
        For the first line that is none.
    """
    _, rows = _style(source, lines)
    for number, line in lines:
        if len(rows.get(number, [])) != columns:
            fault, expected = f"'{line.strip()[:40]}'", f"{columns} finite numbers"
            raise InputError(source.at(number), fault, expected, "Remove or correct the row.")
    return [(number, rows[number]) for number, _ in lines]


def _rows_in_per_cent(source: InstrumentText, lines: Sequence[tuple[int, str]]) -> tuple[Style, dict[int, list[float]]]:
    """Rows whose values all have a sign of per cent, as fractions; none if a value lacks it."""
    style, rows = _style(source, [(number, _PER_CENT.sub("", line)) for number, line in lines])
    signs = {number: len(_PER_CENT.findall(line)) for number, line in lines if not _PER_CENT_FIRST.match(line)}
    if any(signs.get(number) != len(cells) - 1 for number, cells in rows.items()):
        return style, {}
    return style, {number: [cells[0], *(value / 100 for value in cells[1:])] for number, cells in rows.items()}


def _pairs(line: str, style: Style, width: int) -> list[float] | None:
    """Wavelengths and values of a row of several traces; nan for those that have ended."""
    cells = split_cells(line, style.separator)
    cells += [""] * (width - len(cells))
    pairs = [cells[k : k + 2] for k in range(0, width, 2)]
    ended = [pair == ["", ""] for pair in pairs]
    if len(cells) > width or not any(ended) or all(ended):
        return None
    try:
        return [
            float("nan") if end else decimal_number(cell, "", style.decimal)
            for pair, end in zip(pairs, ended, strict=True)
            for cell in pair
        ]
    except InputError:
        return None


def find_table(source: InstrumentText) -> NumberTable:
    """The table of a file: the longest block of rows of numbers.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    NumberTable
        Its rows, and the lines before them. Lines of text after the table are not read.

    Raises
    ------
    InputError
        For no table, a second one, a line within it that is no row, and rows of different lengths.
    """
    filled = [(n, line) for n, line in enumerate(source.lines, start=1) if line.strip()]
    comments = [(n, line.strip().strip('"').lstrip("#/! ")) for n, line in filled if line.strip().startswith(_COMMENTS)]
    numbers = {n for n, _ in comments}
    lines = _without_empty_columns([(n, line) for n, line in filled if n not in numbers])
    style, rows = _style(source, lines)
    if not rows:
        lines = _without_blank_columns(lines)
        style, rows = _style(source, lines)
    from_per_cent = False
    if not rows:
        style, rows = _rows_in_per_cent(source, lines)
        from_per_cent = bool(rows)
    if not rows:
        expected = "a spectrum: rows of a wavelength and values"
        hint = "Export the spectrum as text with a header that names the columns and their units."
        if any(re.search(r"\d\s*%", line) for _, line in lines):
            hint = "Write '%' behind every value, or behind none and into the header, such as 'Reflectance (%)'."
        fault = "no table of numbers" if filled else "an empty file"
        if lines and sum(_NUMBER_LIKE.fullmatch(line.strip()) is not None for _, line in lines) > len(lines) / 2:
            fault = "one column of numbers without wavelengths"
            hint = "If the wavelengths are in another file, put both into one table."
        raise InputError(source.path, fault, expected, hint)
    widest = max(map(len, rows.values()))
    if widest % 2 == 0 and widest > 2 and style.separator != " " and not style.has_unit:
        for number, line in lines:
            if len(rows.get(number, [])) < widest and (numbers_of_pairs := _pairs(line, style, widest)) is not None:
                rows[number] = numbers_of_pairs
    blocks: list[list[int]] = [[]]
    for number, _ in lines:
        if number in rows:
            blocks[-1].append(number)
        elif blocks[-1]:
            blocks.append([])
    table = max(blocks, key=len)
    width = len(rows[table[0]])
    position = {number: index for index, (number, _) in enumerate(lines)}
    first, last = position[table[0]], position[table[-1]]
    for number in table:
        if len(rows[number]) != width:
            fault, expected = f"{len(rows[number])} cells", f"{width} as in line {table[0]}"
            raise InputError(source.at(number), fault, expected, "Correct the row.")
    others = [n for block in blocks if block is not table for n in block if len(rows[n]) == width]
    around = [lines[k] for k in (first - 1, last + 1) if 0 <= k < len(lines)]
    for number, line in around:
        cells = split_cells(line, style.separator)
        within = (others and table[0] < others[0] and number > table[-1]) or (others and others[-1] < table[0] > number)
        if within or (number not in rows and len(cells) > 1 and _NUMBER_LIKE.fullmatch(cells[0])):
            fault, hint = f"'{line.strip()[:40]}'", "Remove or correct the row."
            if within and not any(_NUMBER_LIKE.fullmatch(cell) for cell in cells):
                fault, hint = f"{fault} and a second table below it", "Keep one table in the file."
            raise InputError(source.at(number), fault, f"a row of {width} finite numbers", hint)
    if others:
        hint = "Keep one table in the file."
        raise InputError(source.at(others[0]), "numbers outside the table", f"one table, from line {table[0]}", hint)
    header = [(n, line) for n, line in lines[:first]]
    before = [comment for comment in comments if comment[0] < table[0]]
    return NumberTable(style, [(n, rows[n]) for n in table], header, before, from_per_cent)
