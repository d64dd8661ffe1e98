"""Reading of input files (TOML, JSON, CSV, pictures) of limited size.

Everything that is not a regular, readable file of the expected kind raises an InputError.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .errors import InputError
from .limits import MAX_TABLE_ROWS, MAX_TEXTURE_PIXELS, require_size

__all__ = [
    "inputs_below",
    "kind_of",
    "other_format",
    "read_channels",
    "read_json",
    "read_json_object",
    "read_rows",
    "read_text",
    "read_toml",
    "require_regular_file",
    "separator_hint",
]

#: Characters that other programs write between columns, by their names in messages.
_SEPARATORS = {";": "semicolons", "\t": "tabs"}

#: Largest size of a TOML file, bytes: the files of this project take a few kilobytes.
_MAX_TOML_BYTES = 2**20
#: Largest size of other text files, bytes: a table of 64 bands in steps of 1 nm takes half a megabyte.
_MAX_TEXT_BYTES = 2**25

#: Largest depth of nested tables; known files have at most four levels.
_MAX_DEPTH = 32

#: Characters of an integer of JSON: the largest float has 309 digits.
_MAX_DIGITS = 300

#: Integers of TOML are below this, and at least minus this.
_INT64 = 2**63

#: Largest value of the modes of a PNG.
_FULL_SCALE = {"L": 255.0, "RGB": 255.0, "I": 65535.0, "I;16": 65535.0}

#: By the first bytes of a file that is no text, what it is.
_OTHER_FILES = {
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"II*\0": "a picture (TIFF or camera raw)",
    b"MM\0*": "a picture (TIFF or camera raw)",
    b"PK\x03\x04": "a ZIP file, such as an Excel workbook",
    b"\xd0\xcf\x11\xe0": "an Office document, such as an Excel workbook",
    b"%PDF": "a PDF document",
    b"version https://git-lfs": "a pointer of Git LFS in place of the file, which `git lfs pull` fetches",
}
#: By the ending of a file that is no input of this program, what it is and what takes its place.
_OTHER_ENDINGS = {
    (".jpg", ".jpeg", ".heic", ".heif", ".webp", ".gif", ".bmp"): (
        "a developed picture of 8 bits in a curve, not linear in the light: take the camera's raw file"
    ),
    (".xisf",): "a picture of PixInsight: save it as FITS or 16-bit TIFF",
    (".sif",): "a picture of Andor Solis: export it as FITS or 16-bit TIFF",
    (".spe",): "a picture of LightField or WinSpec: export it as FITS or 16-bit TIFF",
    (".ser", ".avi", ".mp4", ".mov", ".mkv"): "a film: save its frames as FITS or 16-bit TIFF",
    (".nd2", ".czi", ".lif", ".lsm"): "a picture of a microscope's program: export it as OME-TIFF",
    (".psd", ".xcf", ".afphoto"): "a file of a picture editor, which changes counts: take the camera's file",
    (".mat", ".h5", ".hdf5", ".hdf"): "arrays of numbers under any names: save them as NetCDF, ENVI or FITS",
}
#: Marks with which UTF-16 begins, little and big end first.
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
#: Number of bytes at the beginning in which a 0 shows that a file is no UTF-8 text.
_PROBED_BYTES = 1024

#: Beginning of a line with a dotted key of more parts than nested tables may have. Nothing is matched in two ways, so
#: that a million blanks take no longer than a million letters.
_DEEP_KEY = re.compile(r"^[ \t]*+\[{0,2}+[ \t]*+(?:[^\s\"'#=.]{0,200}+[ \t]*+\.[ \t]*+){33}", re.MULTILINE)

#: Line number in a message of the TOML reader.
_LINE = re.compile(r"at line (\d+)")
#: Characters that no text of a file has.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")

#: Hints at frequent faults in a line of TOML, by patterns of the line.
_FREQUENT = {
    r"^\[[^\[\]]+\]$": "Tables that occur several times have double brackets, [[flat]], each of them.",
    r"\\": "Paths are written with / in place of \\.",
    r"=\s*-?\d+,\d": "Numbers have a decimal point, not a comma.",
    r"=\s*-?(\.\d|\d+\.(\D|$))": "Numbers have digits on both sides of the decimal point.",
    r"=\s*(True|False)\b": "Write true and false in small letters.",
    r"=\s*[A-Za-z_./]": "Text stands in quotes.",
    r"^[\w-]+\s+[\w-]+\s*=": "Keys have no spaces.",
}


#: Hint at a name that a file of TOML has twice.
_REPEATED = (
    "This name stands in the file before, and may only once; tables that occur several times have double brackets, "
    "[[flat]], each of them."
)


#: Folders below which inputs are read; None for any folder.
_FOLDERS: ContextVar[tuple[Path, ...] | None] = ContextVar("folders", default=None)


@contextmanager
def inputs_below(*folders: Path) -> Iterator[None]:
    """Refuse inputs outside folders in the block, on its thread.

    Files that other files name are refused, too.

    Parameters
    ----------
    folders
        Folders below which files may be read; links are resolved.

    Yields
    ------
    None
        In the block ``require_regular_file``, which every reader calls, raises InputError for other files.
    """
    token = _FOLDERS.set(tuple(folder.resolve() for folder in folders))
    try:
        yield
    finally:
        _FOLDERS.reset(token)


def _require_allowed_folder(path: Path, expected: str) -> None:
    """Require that a path is below the folders of ``inputs_below``, whether or not it exists."""
    folders = _FOLDERS.get()
    if folders is None:
        return
    try:
        inside = any(path.resolve().is_relative_to(folder) for folder in folders)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(repr(str(path)), str(error), expected) from None
    if not inside:
        raise InputError(path, "a file outside the folder of the workbench", f"{expected} below {folders[0]}")


def require_regular_file(path: Path, expected: str, hint: str = "") -> None:
    """Require that a path is a regular file; reading a pipe or a device might never end.

    Parameters
    ----------
    path
        The path.
    expected
        Words for the file that should be there.
    hint
        How to correct it; empty for none.

    Raises
    ------
    InputError
        If there is no regular file, or if it is outside the folders of ``inputs_below``.
    """
    _require_allowed_folder(path, expected)
    try:
        regular, exists = path.is_file(), path.exists()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(repr(str(path)), str(error), expected, hint) from None
    if not regular:
        raise InputError(path, kind_of(path) if exists else "no such file", expected, hint)


def kind_of(path: Path) -> str:
    """Words for the kind of something that is no regular file.

    Parameters
    ----------
    path
        An existing path.

    Returns
    -------
    str
        "a folder, not a file", "a pipe, not a file" or "something, not a file".
    """
    kind = "a folder" if path.is_dir() else "a pipe" if path.is_fifo() else "something"
    return f"{kind}, not a file"


def other_format(path: Path) -> str:
    """Kind of a file that no reader takes, and what takes its place.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str
        Such as "a picture of PixInsight: save it as FITS or 16-bit TIFF"; empty for other endings.
    """
    return next((text for endings, text in _OTHER_ENDINGS.items() if path.suffix.lower() in endings), "")


def read_text(
    path: Path, expected: str, hint: str = "", largest: int = _MAX_TEXT_BYTES, *, of_windows: bool = False
) -> str:
    """Text of a UTF-8 file, with or without a byte order mark.

    Parameters
    ----------
    path
        The file.
    expected
        Words for the file that should be there.
    hint
        How to correct it if it does not exist; empty for none.
    largest
        Largest permitted size, bytes.
    of_windows
        Whether UTF-16 with a byte order mark and Windows-1252 are read too, as programs of instruments write them.

    Returns
    -------
    str
        The text, with line ends as "\\n".

    Raises
    ------
    InputError
        If the file is missing, not regular, too large or not text in a permitted encoding.
    """
    require_regular_file(path, expected, hint)
    try:
        size = path.stat().st_size
        if size > largest:
            raise InputError(path, f"{size} bytes", f"{expected} of at most {largest} bytes")
        content = path.read_bytes()
        for start, kind in _OTHER_FILES.items():
            if content.startswith(start):
                raise InputError(path, kind, f"{expected} in UTF-8", "Export or save it as text, such as CSV.")
        if of_windows and (text := _windows_text(content)) is not None:
            return text
        if content.startswith(_UTF16_MARKS) or b"\0" in content[:_PROBED_BYTES]:
            fault = "UTF-16 text" if b"\0" in content[1:4:2] else "bytes that are not text"
            raise InputError(path, fault, f"{expected} in UTF-8", "Save it as text in UTF-8.")
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()
    except UnicodeDecodeError:
        hint = "Save it as text in UTF-8."
        raise InputError(path, "bytes that are not UTF-8 text", f"{expected} in UTF-8", hint) from None
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None


def _windows_text(content: bytes) -> str | None:
    """Text in an encoding of Windows; None for UTF-8 and for bytes that are no text."""
    encoding = "utf-16" if content.startswith(_UTF16_MARKS) else "cp1252"
    if encoding == "cp1252" and b"\0" in content:
        return None
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        try:
            return io.TextIOWrapper(io.BytesIO(content), encoding=encoding).read()
        except UnicodeError:
            return None
    return None


def read_toml(path: Path, expected: str, hint: str = "") -> dict[str, Any]:
    """Tables of a TOML file.

    Parameters
    ----------
    path
        The file.
    expected
        Words for the file that should be there.
    hint
        How to correct it if it does not exist; empty for none.

    Returns
    -------
    dict[str, Any]
        The tables.

    Raises
    ------
    InputError
        As `read_text`; for invalid TOML, integers beyond 64 bits (not allowed in TOML), control characters, and more
        than 32 levels of nesting.
    """
    return parse_toml(path, read_text(path, expected, hint, _MAX_TOML_BYTES), expected)


def parse_toml(path: Path, text: str, expected: str) -> dict[str, Any]:
    """Tables of the text of a TOML file.

    Parameters
    ----------
    path
        The file, named in faults.
    text
        Its text.
    expected
        Words for the file that should be there.

    Returns
    -------
    dict[str, Any]
        The tables.

    Raises
    ------
    InputError
        As `read_toml`, for faults of the content.
    """
    if _DEEP_KEY.search(text):  # the parser's time grows with the square of the parts
        raise InputError(path, "values nested too deeply", expected)
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
        if depth > _MAX_DEPTH:
            raise InputError(f"{path}: {key[:80]}", "values nested too deeply", expected)
        if isinstance(value, int) and not -_INT64 <= value < _INT64:
            raise InputError(f"{path}: {key}", "an integer beyond 64 bits", "a smaller number")
    return content


def _toml_hint(text: str, message: str) -> str:
    """The line to which a message of the TOML reader refers, and the usual fault of such a line."""
    number = _LINE.search(message)
    if number is None:
        return ""
    line = text.splitlines()[int(number[1]) - 1].strip() if text else ""
    if "overwrite" in message or "twice" in message:
        return f"Line {number[1]} is: {line[:80]}. {_REPEATED}"
    rule = next((hint for pattern, hint in _FREQUENT.items() if re.search(pattern, line)), "")
    return f"Line {number[1]} is: {line[:80]}" + (f". {rule}" if rule else "")


def _values(content: dict[str, Any]) -> Iterator[tuple[str, Any, int]]:
    """Every key with its value and depth, without recursion; nothing below `_MAX_DEPTH`."""
    stack: list[tuple[str, Any, int]] = [("", content, 0)]
    while stack:
        key, value, depth = stack.pop()
        yield key, value, depth
        if depth > _MAX_DEPTH:
            continue
        if isinstance(value, dict):
            stack += [(f"{key}.{name}".removeprefix("."), below, depth + 1) for name, below in value.items()]
        elif isinstance(value, list):
            stack += [(f"{key}[{index}]", below, depth + 1) for index, below in enumerate(value)]


def read_json(path: Path, expected: str) -> Any:
    """Content of a JSON file.

    Parameters
    ----------
    path
        The file.
    expected
        Words for the file that should be there.

    Returns
    -------
    Any
        The content.

    Raises
    ------
    InputError
        As `read_text`, and for invalid JSON.
    """
    try:
        return json.loads(read_text(path, expected), parse_int=_integer)
    except InputError:
        raise
    except RecursionError:
        raise InputError(path, "values nested too deeply", expected) from None
    except ValueError as error:
        raise InputError(path, f"a fault in the JSON: {error}", expected) from None


def _integer(text: str) -> int:
    """Integer of JSON; ValueError for one that no float can hold."""
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def read_json_object(path: Path, expected: str) -> dict[str, Any]:
    """Content of a JSON file that holds one object.

    Parameters
    ----------
    path
        The file.
    expected
        Words for the file that should be there.

    Returns
    -------
    dict
        The object.

    Raises
    ------
    InputError
        As `read_json`, and for another content, such as a list.
    """
    content = read_json(path, expected)
    if not isinstance(content, dict):
        raise InputError(path, "JSON without an object at the top", expected)
    return content


def read_rows(path: Path, expected: str = "a CSV file") -> list[tuple[int, list[str]]]:
    """Lines of a CSV file that are not blank.

    Parameters
    ----------
    path
        The file.
    expected
        Words for the file that should be there.

    Returns
    -------
    list[tuple[int, list[str]]]
        Line number and cells of each line.

    Raises
    ------
    InputError
        As `read_text`, and for invalid CSV.
    """
    try:
        text = read_text(path, expected)
        require_size(path, text.count("\n"), MAX_TABLE_ROWS, "rows")
        reader = csv.reader(io.StringIO(text, newline=""))
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(path, str(error), expected) from None


def separator_hint(header: str) -> str:
    """Hint at a separator of columns other than the comma.

    Parameters
    ----------
    header
        First cell of the table's header.

    Returns
    -------
    str
        A hint if the cell holds another separator; empty otherwise.
    """
    used = next((name for mark, name in _SEPARATORS.items() if mark in header), None)
    return f"Its columns are separated by {used}: write commas, and decimal points." if used else ""


def read_channels(path: Path) -> NDArray[np.float64]:
    """Values of a picture (PNG) or of an array (NumPy).

    Parameters
    ----------
    path
        File of a grey or RGB PNG, or of an array of 2 or 3 axes.

    Returns
    -------
    NDArray
        (rows, columns, channels); of a PNG, values over the largest of their type, 0 to 1.

    Raises
    ------
    InputError
        For a file that is neither, or has values that are not finite.
    """
    expected = "a grey or RGB picture (.png), or an array of (rows, columns) or (rows, columns, channels) (.npy)"
    require_regular_file(path, expected)
    try:
        if path.suffix.lower() == ".npy":
            stored = np.load(path, mmap_mode="r", allow_pickle=False)
            require_size(path, stored.size, 3 * MAX_TEXTURE_PIXELS, "values")
            values = stored.astype(np.float64)
        else:
            with Image.open(path, formats=["PNG"]) as picture:
                if picture.mode not in _FULL_SCALE:
                    raise InputError(path, f"a picture of kind '{picture.mode}'", expected)
                require_size(path, picture.width * picture.height, MAX_TEXTURE_PIXELS, "pixels")
                values = np.asarray(picture, np.float64) / _FULL_SCALE[picture.mode]
    except InputError:
        raise
    except Exception as error:  # the readers raise exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", expected) from None
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or not values.size or not np.isfinite(values).all():
        raise InputError(path, f"an array of shape {values.shape}, or not finite", expected)
    return values
