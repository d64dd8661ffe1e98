"""Frame readers of other packages: their record, and what their functions give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.other_packages import guarded, require, require_fields
from numpy.typing import NDArray

from ._frame_reader import FrameFacts, FrameHeader, FrameReader

__all__ = ["checked_reader"]


def checked_reader(reader: FrameReader, where: str) -> FrameReader:
    """Frame reader of another package whose functions' faults are InputErrors.

    Parameters
    ----------
    reader
        The reader as the package has it.
    where
        The entry point, for messages.

    Returns
    -------
    FrameReader
        A copy. Its functions raise InputError where those of the package raise any exception or give a value of
        another type.

    Raises
    ------
    InputError
        For fields of another type than those of ``FrameReader``.
    """
    endings = reader.suffixes
    sound = {
        "id": isinstance(reader.id, str) and reader.id.isprintable() and bool(reader.id),
        "name or install": isinstance(reader.name, str) and isinstance(reader.install, str),
        "suffixes": isinstance(endings, tuple) and bool(endings) and all(map(_is_ending, endings)),
        "needs": reader.needs is None or isinstance(reader.needs, str),
        "header or read": callable(reader.header) and callable(reader.read),
        "values": reader.values is None or callable(reader.values),
    }
    require_fields(where, reader, sound)

    def header(path: Path) -> FrameHeader:
        expected = f"the header of {path}"
        with guarded(where, expected):
            value = reader.header(path)
            _require_header(value, where, expected)
        return value

    return replace(
        reader,
        header=header,
        read=_checked_read(reader.read, "u", where),
        values=None if reader.values is None else _checked_read(reader.values, "uif", where),
    )


def _require_header(header: Any, where: str, expected: str) -> None:
    """Check the types of a header. Raises InputError for others."""
    require(isinstance(header, FrameHeader), where, f"a {type(header).__name__}", f"{expected}, a FrameHeader")
    is_size = isinstance(header.shape, tuple) and len(header.shape) == 2
    is_size = is_size and all(isinstance(n, int) and n > 0 for n in (*header.shape, header.pictures))
    require(is_size, where, f"{header.pictures} pictures of {header.shape}", f"{expected}, whole numbers above 0")
    facts = isinstance(header.facts, FrameFacts) and isinstance(header.bands, tuple)
    require(facts, where, "facts or bands of another type", f"{expected}, with FrameFacts and names")


def _is_ending(text: object) -> bool:
    return isinstance(text, str) and text.startswith(".") and text == text.lower()


def _checked_read(
    function: Callable[[Path, range], NDArray[Any]], kinds: str, where: str
) -> Callable[[Path, range], NDArray[Any]]:
    """Function that reads pictures, whose values are of some kinds of numbers."""

    def read(path: Path, pictures: range) -> NDArray[Any]:
        expected = f"the pictures of {path}"
        with guarded(where, expected):
            values = function(path, pictures)
            require(isinstance(values, np.ndarray), where, f"a {type(values).__name__}", f"{expected}, an array")
            kind = f"{values.dtype} numbers" if values.dtype.kind != "O" else "objects"
            number = "counts (uint16)" if kinds == "u" else "numbers"
            sound = values.dtype == np.uint16 if kinds == "u" else values.dtype.kind in kinds
            require(sound, where, kind, f"{expected} as {number}")
        return values

    return read
