"""Text header of an ENVI file, as cameras, satellites and laboratories write it.

Format: "ENVI Header Files", documentation of ENVI (NV5 Geospatial). A header is ``key = value`` by line. A value in
braces may span several lines, and may begin on the line after its key. Lines that begin with a semicolon are comments.
Keys are read in any case and with any space. Text is UTF-8 or, as older programs for Windows write it, Latin-1.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import require_regular_file
from cboxlab.utils.numbers import number_of, whole_number_of
from numpy.typing import NDArray

__all__ = ["EnviHeader", "is_envi", "read_header"]

#: Largest size of a header, bytes: a list of 10,000 bands takes a tenth of it.
_LARGEST_BYTES = 2**20

_LINE_END = re.compile(r"\r\n|\n|\r")


@dataclass(frozen=True)
class EnviHeader(FrozenMappings):
    """The entries of a header, and its file for messages."""

    #: File of the header.
    path: Path
    #: Values by key in lower case, without braces; lines of a value in braces are kept apart by ``\\n``.
    entries: dict[str, str]
    #: First values of keys that are stated again with other values.
    contradicted: dict[str, str]

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def text(self, key: str) -> str | None:
        """An entry as one line without comments.

        Parameters
        ----------
        key
            Key in lower case.

        Returns
        -------
        str or None
            None where the header lacks the key.

        Raises
        ------
        InputError
            If the header states the key again with another value.
        """
        if key not in self.entries:
            return None
        if key in self.contradicted:
            both = " and ".join(repr(each[:40]) for each in (self.contradicted[key], self.entries[key]))
            raise InputError(f"{self.path}: {key}", both, "one value", "Delete the line that is wrong.")
        return " ".join(line.partition(";")[0].strip() for line in self.entries[key].split("\n")).strip()

    def integer(self, key: str, default: int | None = None) -> int:
        """A whole number.

        Parameters
        ----------
        key
            Key in lower case.
        default
            Value where the header lacks the key; None where the key is required.

        Returns
        -------
        int
            The number.

        Raises
        ------
        InputError
            If a required key is missing, or the value is no whole number.
        """
        text = self.text(key)
        if text is None and default is not None:
            return default
        number = whole_number_of(text or "")
        if number is None:
            value = "nothing" if text is None else repr(text[:80])
            hint = "Write 0 for little-endian samples (PCs), 1 for big-endian ones." if key == "byte order" else ""
            raise InputError(f"{self.path}: {key}", value, "a whole number", hint)
        return number

    def numbers(self, key: str) -> NDArray[np.float64]:
        """A list of numbers, separated by commas or by spaces; one comma may follow the last.

        Parameters
        ----------
        key
            Key in lower case.

        Returns
        -------
        NDArray
            (n,) numbers; empty where the header lacks the key, or its list is empty.

        Raises
        ------
        InputError
            If a part of the list is no finite number.
        """
        text = self.text(key)
        if not text:
            return np.zeros(0)
        parts = [part.strip() for part in text.split(",")] if "," in text else text.split()
        if not parts[-1]:
            parts.pop()
        values = np.array([number_of(part) for part in parts])
        if not np.isfinite(values).all():
            beginning = text if len(text) <= 80 else f"{text[:80]}..."
            raise InputError(f"{self.path}: {key}", beginning, "a list of finite numbers, separated by commas")
        return values

    def numbers_by_band(self, key: str, bands: int, default: float) -> NDArray[np.float64]:
        """A number for each band; one number alone counts for all bands.

        Parameters
        ----------
        key
            Key in lower case.
        bands
            Number of bands.
        default
            Value of all bands where the header lacks the key.

        Returns
        -------
        NDArray
            (bands,) numbers.

        Raises
        ------
        InputError
            If the list has another number of values than 1 or ``bands``, or holds what is no number.
        """
        values = self.numbers(key)
        if values.size == 0:
            return np.full(bands, default)
        if values.size not in (1, bands):
            raise InputError(f"{self.path}: {key}", f"{values.size} values", f"{bands}, the value of bands")
        return np.broadcast_to(values, bands).copy()


def is_envi(path: Path) -> bool:
    """Whether the file begins as ENVI's headers do.

    Parameters
    ----------
    path
        File of any kind.

    Returns
    -------
    bool
        True for 'ENVI' at its beginning, after a byte order mark if there is one.
    """
    with path.open("rb") as file:
        return file.read(7).removeprefix(b"\xef\xbb\xbf").startswith(b"ENVI")


def read_header(path: Path) -> EnviHeader:
    """The entries of a header.

    Parameters
    ----------
    path
        File of the header.

    Returns
    -------
    EnviHeader
        Its entries.

    Raises
    ------
    InputError
        If the file is missing, too large, no text, or does not begin with 'ENVI', and if a brace is not closed.
    """
    lines = deque(_LINE_END.split(_text(path)))
    if not lines.popleft().startswith("ENVI"):
        raise InputError(path, "no 'ENVI' in its first line", "an ENVI header")
    entries: dict[str, str] = {}
    contradicted: dict[str, str] = {}
    while lines:
        key, equals, value = (part.strip() for part in lines.popleft().partition("="))
        if equals and key and not key.startswith(";"):
            name = " ".join(key.lower().split())
            text = _value(path, name, value, lines)
            if entries.setdefault(name, text).lower() != text.lower():
                contradicted[name], entries[name] = entries[name], text
    return EnviHeader(path, entries, contradicted)


def _value(path: Path, key: str, first: str, lines: deque[str]) -> str:
    """A value without its braces; its further lines are taken from the beginning of ``lines``."""
    while not first and lines and (not lines[0].strip() or lines[0].lstrip().startswith(("{", ";"))):
        first = lines.popleft().strip().partition(";")[0]  # the brace may stand on a later line
    if not first.startswith("{"):
        return first
    parts = [first.lstrip("{")]
    while "}" not in parts[-1] and lines:
        line = lines.popleft()
        if not line.lstrip().startswith(";"):
            parts.append(line.strip())
    if "}" not in parts[-1]:
        hint = "The header is truncated, or lacks the brace: write the value to its end."
        raise InputError(f"{path}: {key}", "'{' without a '}' after it", "a value in braces", hint)
    parts[-1] = parts[-1].partition("}")[0]
    return "\n".join(parts).strip()


def _text(path: Path) -> str:
    """The text of a header, UTF-8 or Latin-1."""
    require_regular_file(path, "an ENVI header")
    try:
        size = path.stat().st_size
        if size > _LARGEST_BYTES:
            raise InputError(path, f"{size} bytes", f"an ENVI header of at most {_LARGEST_BYTES} bytes")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "an ENVI header") from None
    if b"\0" in content:
        raise InputError(path, "bytes that are not text", "an ENVI header", "Save it as text in UTF-8 or Latin-1.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")
