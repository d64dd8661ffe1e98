"""Frames of a capture: files that a frame reader knows, with linear counts (DN)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..frame_readers import FrameHeader, frame_header, read_pictures, read_values

__all__ = [
    "UNKNOWN_VALUE",
    "check_frame",
    "picture_names",
    "pictures_by_file",
    "read_frame",
    "read_frames",
    "read_merged",
    "split_name",
]

#: Value that stands for one that is not finite in a merged picture: the largest of single precision, never measured.
UNKNOWN_VALUE = float(np.finfo(np.float32).max)

#: One picture of a file with several, such as ``box.fits[3]``.
_PICTURE = re.compile(r"(?P<file>.+)\[(?P<number>\d{1,6})\]")


def split_name(folder: Path, name: str) -> tuple[str, int | None]:
    """File and number of a picture by its name in a manifest.

    Parameters
    ----------
    folder
        Folder of the capture.
    name
        Path in the manifest, with the number of one picture in brackets or without.

    Returns
    -------
    tuple
        Path of the file, and the number; None for all its pictures. A file whose name ends in brackets is itself.
    """
    match = _PICTURE.fullmatch(name)
    if match is None or (folder / name).is_file():
        return name, None
    return match["file"], int(match["number"])


def picture_names(folder: Path, name: str) -> tuple[str, ...]:
    """Names of the pictures of a file, one per repeat.

    Parameters
    ----------
    folder
        Folder of the capture.
    name
        Path in the manifest.

    Returns
    -------
    tuple
        ``name`` itself for one picture, else ``name[0]``, ``name[1]`` ...
    """
    file, number = split_name(folder, name)
    if number is not None or (count := frame_header(folder / file).pictures) == 1:
        return (name,)
    return tuple(f"{name}[{k}]" for k in range(count))


def pictures_by_file(folder: Path, names: Sequence[str]) -> Iterator[tuple[Path, range | None]]:
    """Files and numbers of pictures to read at a time, so that a packed cube is unpacked once.

    Parameters
    ----------
    folder
        Folder of the capture.
    names
        Names of pictures in the manifest.

    Yields
    ------
    tuple
        Path of a file and the numbers of consecutive pictures of it; None for a file of one picture.
    """
    pairs = [split_name(folder, name) for name in names]
    # pictures of one file whose numbers rise by one are read together
    for _, group in groupby(enumerate(pairs), key=lambda pair: (pair[1][0], (pair[1][1] or 0) - pair[0])):
        members = [pair for _, pair in group]
        file, first = members[0]
        yield folder / file, None if first is None else range(first, first + len(members))


def check_frame(path: Path, height: int, width: int, *, one_band: bool = False, merged: bool = False) -> FrameHeader:
    """Check a file of frames by its header: format, size, completeness.

    Parameters
    ----------
    path
        The file.
    height
        Rows that the manifest states, px.
    width
        Columns that the manifest states, px.
    one_band
        Whether the manifest names one of the file's pictures, which may then be of different bands.
    merged
        Whether the frames are merged pictures of floating-point values.

    Returns
    -------
    FrameHeader
        Header of the file.

    Raises
    ------
    InputError
        For a file that is missing, damaged, of another size, or that holds several bands.
    """
    header = frame_header(path)
    if header.shape != (height, width):
        raise InputError(
            path,
            f"{header.shape[1]} x {header.shape[0]} pixels (width x height)",
            f"{width} x {height} as in [camera] of capture.toml",
        )
    if header.is_floating and not merged:
        hint = "State the noise of merged pictures in [noise], or export counts."
        raise InputError(path, "floating-point values", "counts of 16 bits", hint)
    if header.bands and not one_band:
        hint = f"Name one of them, such as '{path.name}[0]' for {header.bands[0]}, or write each band into a file."
        raise InputError(path, f"the bands {', '.join(header.bands)} in one file", "frames of one band", hint)
    return header


def _require_pictures(path: Path, header: FrameHeader, pictures: range | None) -> None:
    """Raise InputError for pictures that a file does not hold."""
    if pictures is not None and pictures.stop > header.pictures:
        expected = f"0 to {header.pictures - 1}: the file holds {header.pictures} pictures"
        raise InputError(path, f"the picture [{pictures.stop - 1}]", expected)


def read_merged(path: Path, height: int, width: int, pictures: range | None = None) -> NDArray[np.float64]:
    """Values of merged pictures of a file.

    Parameters
    ----------
    path
        The file.
    height
        Rows that the manifest states, px.
    width
        Columns that the manifest states, px.
    pictures
        Numbers of the pictures; all where left out.

    Returns
    -------
    NDArray
        (n, height, width) values; UNKNOWN_VALUE for those that are not finite.

    Raises
    ------
    InputError
        If the header does not fit, or a picture is not in the file.
    """
    header = check_frame(path, height, width, one_band=pictures is not None, merged=True)
    _require_pictures(path, header, pictures)
    values = read_values(path, pictures)
    return np.where(np.isfinite(values), np.minimum(values, UNKNOWN_VALUE), UNKNOWN_VALUE)


def read_frames(
    path: Path, height: int, width: int, bit_depth: int, pictures: range | None = None
) -> NDArray[np.uint16]:
    """Counts of pictures of a file.

    Parameters
    ----------
    path
        The file.
    height
        Rows that the manifest states, px.
    width
        Columns that the manifest states, px.
    bit_depth
        Bits of a count: counts are 0 to 2^bit_depth - 1.
    pictures
        Numbers of the pictures; all where left out.

    Returns
    -------
    NDArray
        (n, height, width) counts, uint16, DN.

    Raises
    ------
    InputError
        If the header does not fit, a picture is not in the file, or a count is out of range.
    """
    _require_pictures(path, check_frame(path, height, width, one_band=pictures is not None), pictures)
    counts = read_pictures(path, pictures)
    limit = 2**bit_depth - 1
    if counts.max() > limit:
        raise InputError(
            path,
            f"a count of {counts.max()}",
            f"0 to {limit} (bit_depth = {bit_depth})",
            "Store counts in the lower bits, or correct bit_depth in capture.toml.",
        )
    return counts


def read_frame(path: Path, height: int, width: int, bit_depth: int, picture: int = 0) -> NDArray[np.uint16]:
    """Counts of one picture of a file.

    Parameters
    ----------
    path
        The file.
    height
        Rows that the manifest states, px.
    width
        Columns that the manifest states, px.
    bit_depth
        Bits of a count: counts are 0 to 2^bit_depth - 1.
    picture
        Number of the picture in the file.

    Returns
    -------
    NDArray
        (height, width) counts, uint16, DN.

    Raises
    ------
    InputError
        See ``read_frames``.
    """
    counts: NDArray[np.uint16] = read_frames(path, height, width, bit_depth, range(picture, picture + 1))[0]
    return counts
