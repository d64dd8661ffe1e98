"""Readers of frames: one file per format, and those of entry point ``cboxlab.frames``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from cboxlab.utils.limits import MAX_FRAME_PIXELS, require_size
from cboxlab.utils.other_packages import loaders_of, records_in, with_others
from numpy.typing import NDArray

from ._frame_reader import FrameFacts, FrameHeader, FrameReader, MissingPackageError, as_counts, mosaic_pattern
from ._of_other_packages import checked_reader
from ._settings_files import settings_of, with_settings

__all__ = [
    "FrameFacts",
    "FrameHeader",
    "FrameReader",
    "MissingPackageError",
    "as_counts",
    "frame_header",
    "frame_reader_catalogue",
    "mosaic_pattern",
    "read_pictures",
    "read_values",
    "reader_of",
    "settings_of",
    "suffixes",
]

#: Type of the values of pictures.
Number = TypeVar("Number", np.uint16, np.float64)

#: Entry points of this group are readers of other packages.
_GROUP = "cboxlab.frames"
#: Headers kept: a capture's frames are checked once and read several times.
_HEADERS_KEPT = 4096
#: Files whose pictures are kept: a calibration reads each frame four or five times.
_FILES_KEPT = 256
#: Most pixels of these, in all pictures of a file: 256 files of counts then take 32 MiB.
_MOST_PIXELS_KEPT = 2**16
#: Age of a file from which its pictures are kept, ns: a second change within the clock's step would not be noticed.
_SETTLED_NS = 2 * 10**9


@lru_cache(maxsize=1)
def frame_reader_catalogue() -> dict[str, FrameReader]:
    """All readers, those of other packages included.

    Returns
    -------
    dict
        By identifier, the readers.

    Raises
    ------
    InputError
        For an entry point that cannot be loaded or is no sound FrameReader. For an identifier or an ending of another.
    """
    readers: dict[str, FrameReader] = records_in(__name__, "READER")
    endings = {ending for reader in readers.values() for ending in reader.suffixes}

    def with_new_endings(reader: FrameReader, where: str) -> FrameReader:
        checked = checked_reader(reader, where)
        if shared := [ending for ending in checked.suffixes if ending in endings]:
            raise InputError(where, f"the ending {shared[0]}, which has a reader already", "other endings")
        endings.update(checked.suffixes)
        return checked

    return with_others(readers, loaders_of(_GROUP, FrameReader), with_new_endings)


def suffixes() -> tuple[str, ...]:
    """All endings of file names that a reader takes.

    Returns
    -------
    tuple
        In small letters with the dot, those of TIFF first.
    """
    first = frame_reader_catalogue()["tiff"].suffixes
    return (
        *first,
        *(ending for reader in frame_reader_catalogue().values() for ending in reader.suffixes if ending not in first),
    )


def reader_of(path: Path) -> FrameReader | None:
    """The reader for a file by the ending of its name.

    Parameters
    ----------
    path
        Path of the file, which need not exist.

    Returns
    -------
    FrameReader | None
        The one with the longest ending that fits; None if no ending fits.
    """
    name = path.name.lower()
    fitting = [
        (len(end), reader)
        for reader in frame_reader_catalogue().values()
        for end in reader.suffixes
        if name.endswith(end)
    ]
    return max(fitting, key=lambda pair: pair[0])[1] if fitting else None


def _usable_reader(path: Path) -> FrameReader:
    """The reader for a file whose package is installed. Other endings are those of TIFF frames."""
    reader = reader_of(path) or frame_reader_catalogue()["tiff"]
    require_regular_file(path, f"a {reader.name} frame")
    if reader.needs is not None and find_spec(reader.needs) is None:
        requirement = f"a file that needs the package {reader.needs} to be read"
        raise MissingPackageError(path, requirement, "that package installed", reader.install)
    return reader


def _unreadable(path: Path, reader: FrameReader, error: BaseException) -> InputError:
    fault = f"a file that cannot be read as {reader.name} ({error})"
    if "imagecodecs" in str(error):  # of tifffile, for rare compressions
        hint = "Install it (pip install imagecodecs), or save the file without compression."
        return InputError(path, fault, f"a {reader.name} frame", hint)
    return InputError(path, fault, f"a {reader.name} frame", "The file is damaged or truncated: copy it again.")


@lru_cache(maxsize=_HEADERS_KEPT)
def _header_as_of(path: Path, changed_ns: int, size: int) -> FrameHeader:
    """Header of one version of a file."""
    reader = _usable_reader(path)
    try:
        header = reader.header(path)
        header = replace(header, facts=with_settings(path, header.facts))
        require_size(path, header.shape[0] * header.shape[1], MAX_FRAME_PIXELS, "pixels")
        return header
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # each library raises its own exceptions for damaged files
        raise _unreadable(path, reader, error) from None


def frame_header(path: Path) -> FrameHeader:
    """Size of a file's pictures and what it says of camera and lens, without its counts.

    Parameters
    ----------
    path
        The file. Its ending chooses the reader; one with an unknown ending is read as TIFF.

    Returns
    -------
    FrameHeader
        Number and size of the pictures, and the facts.

    Raises
    ------
    InputError
        For a file that is missing or damaged, and for a package that is not installed.
    """
    reader = _usable_reader(path)
    try:
        state = path.stat()
    except OSError as error:
        raise _unreadable(path, reader, error) from None
    return _header_as_of(path, state.st_mtime_ns, state.st_size)


def read_pictures(path: Path, pictures: range | None = None) -> NDArray[np.uint16]:
    """Counts of pictures of a file.

    Parameters
    ----------
    path
        The file.
    pictures
        Numbers of the pictures, from 0; all of them where left out.

    Returns
    -------
    NDArray
        (n, y, x) counts, uint16, first row at the top.

    Raises
    ------
    InputError
        For a file that is missing or damaged, for values that are no counts, and for a package that is not
        installed.
    """
    reader = _usable_reader(path)
    return _checked_pictures(path, reader, reader.read, pictures)


def read_values(path: Path, pictures: range | None = None) -> NDArray[np.float64]:
    """Values of pictures of a file, as merged exposures have them.

    Parameters
    ----------
    path
        The file. A format of counts gives its counts.
    pictures
        Numbers of the pictures, from 0; all of them where left out.

    Returns
    -------
    NDArray
        (n, y, x) values as stored, first row at the top.

    Raises
    ------
    InputError
        For a file that is missing or damaged, and for a package that is not installed.
    """
    reader = _usable_reader(path)
    if reader.values is None:
        return read_pictures(path, pictures).astype(np.float64)
    return _checked_pictures(path, reader, reader.values, pictures)


def _checked_pictures(
    path: Path, reader: FrameReader, read: Callable[[Path, range], NDArray[Number]], pictures: range | None
) -> NDArray[Number]:
    """(n, y, x) pictures of a file by its reader, of the shape in the header."""
    header: FrameHeader = frame_header(path)
    pictures = range(header.pictures) if pictures is None else pictures
    shape, state = (len(pictures), *header.shape), path.stat()
    if np.prod(shape) > _MOST_PIXELS_KEPT or time.time_ns() - state.st_mtime_ns < _SETTLED_NS:
        return _pictures(path, reader, read, pictures, shape)
    return _pictures_as_of(path, state.st_mtime_ns, state.st_size, reader, read, pictures, shape).copy()


@lru_cache(maxsize=_FILES_KEPT)
def _pictures_as_of(path: Path, changed_ns: int, size: int, *arguments: Any) -> NDArray[Any]:
    """Pictures of one version of a file."""
    return _pictures(path, *arguments)


def _pictures(
    path: Path,
    reader: FrameReader,
    read: Callable[[Path, range], NDArray[Number]],
    pictures: range,
    shape: tuple[int, ...],
) -> NDArray[Number]:
    try:
        values = read(path, pictures)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise _unreadable(path, reader, error) from None
    if values.shape != shape:
        raise InputError(path, f"pictures of shape {values.shape}", f"{shape} as in the file's header")
    return values
