"""Reading of files (TOML, JSON, CSV, pictures): regular files of limited size; an InputError for all others."""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .errors import InputError

__all__ = [
    "kind_of",
    "read_channels",
    "read_json",
    "read_rows",
    "read_text",
    "read_toml",
    "require_regular_file",
    "separator_hint",
]

#: Characters that other programs write between columns.
_SEPARATORS = {";": "semicolons", "\t": "tabs"}

#: Largest size of files that are read, bytes; a table of 64 bands in steps of 1 nm takes half a megabyte.
_LARGEST_TOML, _LARGEST_TEXT = 2**20, 2**25

#: Largest depth of nested tables; known files have at most four levels.
_DEEPEST = 32

_INT64 = 2**63

#: The largest value of a PNG's mode.
_FULL = {"L": 255.0, "RGB": 255.0, "I": 65535.0, "I;16": 65535.0}

#: The marks with which UTF-16 begins, little and big end first; bytes in which a 0 shows that they are no UTF-8 text.
_UTF16, _SNIFFED = (b"\xff\xfe", b"\xfe\xff"), 1024

_LINE = re.compile(r"at line (\d+)")
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")

#: Faults in a line of TOML that are made often, and how they are mended.
_FREQUENT = {
    r"^\[[^\[\]]+\]$": "Tables that occur several times have double brackets, [[flat]], each of them.",
    r"\\": "Paths are written with / in place of \\.",
    r"=\s*-?\d+,\d": "Numbers have a decimal point, not a comma.",
    r"=\s*-?(\.\d|\d+\.(\D|$))": "Numbers have digits on both sides of the decimal point.",
    r"=\s*(True|False)\b": "Write true and false in small letters.",
    r"=\s*[A-Za-z_./]": "Text stands in quotes.",
    r"^[\w-]+\s+[\w-]+\s*=": "Keys have no spaces.",
}


_REPEATED = (
    "This name stands in the file before, and may only once; tables that occur several times have double brackets, "
    "[[flat]], each of them."
)


def require_regular_file(path: Path, expected: str, hint: str = "") -> None:
    """Raise InputError if ``path`` is not a regular file (reading a pipe or a device might never end)."""
    try:
        regular, there = path.is_file(), path.exists()
    except (OSError, ValueError) as error:
        raise InputError(repr(str(path)), str(error), expected, hint) from None
    if not regular:
        raise InputError(path, kind_of(path) if there else "no such file", expected, hint)


def kind_of(path: Path) -> str:
    """What there is in place of a regular file."""
    kind = "a folder" if path.is_dir() else "a pipe" if path.is_fifo() else "something"
    return f"{kind}, not a file"


def read_text(path: Path, expected: str, hint: str = "", largest: int = _LARGEST_TEXT) -> str:
    """The text of a UTF-8 file. Raises InputError for anything else, and for files of more than ``largest`` bytes.

    expected : what the file should be. hint : what to do if it does not exist.
    """
    require_regular_file(path, expected, hint)
    try:
        size = path.stat().st_size
        if size > largest:
            raise InputError(path, f"{size} bytes", f"{expected} of at most {largest} bytes")
        content = path.read_bytes()
        if content.startswith(_UTF16) or b"\0" in content[:_SNIFFED]:
            found = "UTF-16 text" if b"\0" in content[1:4:2] else "bytes that are not text"
            raise InputError(path, found, f"{expected} in UTF-8", "Save it as text in UTF-8.")
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()
    except UnicodeDecodeError:
        hint = "Save it as text in UTF-8."
        raise InputError(path, "bytes that are not UTF-8 text", f"{expected} in UTF-8", hint) from None
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None


def read_toml(path: Path, expected: str, hint: str = "") -> dict[str, Any]:
    """The tables of a TOML file. Raises InputError like ``read_text``, for invalid TOML, for integers beyond 64 bits
    (not allowed in TOML), and for more than 32 levels of nesting.
    """
    return parse_toml(path, read_text(path, expected, hint, _LARGEST_TOML), expected)


def parse_toml(path: Path, text: str, expected: str) -> dict[str, Any]:
    """The tables of the text of a TOML file; see ``read_toml``."""
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise InputError(path, "values nested too deeply", expected) from None
    except ValueError as error:  # faults of the TOML; integers of thousands of digits
        raise InputError(path, f"a fault in the TOML: {error}", expected, _toml_hint(text, str(error))) from None
    for key, value, depth in _values(content):
        if isinstance(value, str) and (odd := _CONTROL.search(value)):
            hint = "In double quotes a backslash begins an escape: write paths with /."
            raise InputError(f"{path}: {key}", f"a control character, {odd[0]!r}, in {value!r}", "text", hint)
        if depth > _DEEPEST:
            raise InputError(f"{path}: {key[:80]}", "values nested too deeply", expected)
        if isinstance(value, int) and not -_INT64 <= value < _INT64:
            raise InputError(f"{path}: {key}", "an integer beyond 64 bits", "a smaller number")
    return content


def _toml_hint(text: str, message: str) -> str:
    """The line that ``message`` speaks of, and what is mostly wrong with such a line."""
    number = _LINE.search(message)
    if number is None:
        return ""
    line = text.splitlines()[int(number[1]) - 1].strip() if text else ""
    if "overwrite" in message or "twice" in message:
        return f"Line {number[1]} is: {line[:80]}. {_REPEATED}"
    rule = next((hint for pattern, hint in _FREQUENT.items() if re.search(pattern, line)), "")
    return f"Line {number[1]} is: {line[:80]}" + (f". {rule}" if rule else "")


def _values(content: dict[str, Any]) -> Iterator[tuple[str, Any, int]]:
    """Every key with its value and depth, without recursion."""
    stack: list[tuple[str, Any, int]] = [("", content, 0)]
    while stack:
        key, value, depth = stack.pop()
        yield key, value, depth
        if depth > _DEEPEST:
            continue
        if isinstance(value, dict):
            stack += [(f"{key}.{name}".removeprefix("."), below, depth + 1) for name, below in value.items()]
        elif isinstance(value, list):
            stack += [(f"{key}[{index}]", below, depth + 1) for index, below in enumerate(value)]


def read_json(path: Path, expected: str) -> Any:
    """The content of a JSON file. Raises InputError like ``read_text``, and for invalid JSON."""
    try:
        return json.loads(read_text(path, expected))
    except InputError:
        raise
    except RecursionError:
        raise InputError(path, "values nested too deeply", expected) from None
    except ValueError as error:
        raise InputError(path, f"a fault in the JSON: {error}", expected) from None


def read_rows(path: Path, expected: str = "a CSV file") -> list[tuple[int, list[str]]]:
    """(line number, cells) of every line of a CSV file that is not blank. Raises InputError like ``read_text``."""
    try:
        reader = csv.reader(io.StringIO(read_text(path, expected), newline=""))
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(path, str(error), expected) from None


def separator_hint(header: str) -> str:
    """How to mend a table whose header's first cell holds another separator than the comma; empty if it holds none."""
    used = next((name for mark, name in _SEPARATORS.items() if mark in header), None)
    return f"Its columns are separated by {used}: write commas, and decimal points." if used else ""


def read_channels(path: Path) -> NDArray[np.float64]:
    """(rows, columns, channels) of a grey or RGB PNG, its values over the largest of their type, or of a NumPy array.

    Raises InputError for a file that is neither, or not finite.
    """
    expected = "a grey or RGB picture (.png), or an array of (rows, columns) or (rows, columns, channels) (.npy)"
    require_regular_file(path, expected)
    try:
        if path.suffix.lower() == ".npy":
            values = np.load(path, allow_pickle=False).astype(np.float64)
        else:
            with Image.open(path, formats=["PNG"]) as picture:
                if picture.mode not in _FULL:
                    raise InputError(path, f"a picture of kind '{picture.mode}'", expected)
                values = np.asarray(picture, np.float64) / _FULL[picture.mode]
    except InputError:
        raise
    except Exception as error:  # the readers raise exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", expected) from None
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or not values.size or not np.isfinite(values).all():
        raise InputError(path, f"an array of shape {values.shape}, or not finite", expected)
    return values
