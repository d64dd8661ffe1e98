"""Records of the frame readers: what a reader is, and what it finds in a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

__all__ = [
    "FrameFacts",
    "FrameHeader",
    "FrameReader",
    "MissingPackageError",
    "as_counts",
    "mosaic_pattern",
    "positive_number",
    "require_plausible_size",
]

#: Hint for pictures that no reader takes as counts.
EXPORT_HINT = "Export it again as a one-channel 16-bit unsigned TIFF."
#: Largest size of unpacked counts over the size of their file: deflate packs 1032 bytes into one at most.
_MAX_UNPACKING = 1032
#: Bytes that a file of any size may unpack to: an empty picture of a small sensor packs better than deflate's limit.
_MIN_UNPACKED_BYTES = 2**24
#: Rows and columns of a mosaic's repeat, at most; X-Trans has 6 x 6.
_MAX_REPEAT = 8


class MissingPackageError(InputError):
    """A frame whose reader needs an optional package that is not installed."""


@dataclass(frozen=True)
class FrameFacts(FrozenMappings):
    """Settings of the camera as the file itself states them; None where it states nothing."""

    #: Exposure time, s.
    exposure_s: float | None = None
    #: F-number of the lens.
    f_number: float | None = None
    #: Sensitivity of the converter, ISO.
    iso: float | None = None
    #: By channel of the mosaic ("R", "G", "B"; "" without one), counts of no light and no exposure, DN.
    black_level: Mapping[str, float] | None = None
    #: Largest count of the converter, DN.
    white_level: float | None = None
    #: Letters of the mosaic from the upper left pixel of the frame, as ``mosaic.pattern`` of a capture has them.
    pattern: str | None = None
    #: Nominal focal length, mm.
    focal_length_mm: float | None = None
    #: When the exposure began, without time zone.
    time: datetime | None = None
    #: Kind of frame in the words of the file, in small letters: "dark", "light frame", "flat".
    kind: str | None = None
    #: Name of the filter.
    filter: str | None = None
    #: Name of the camera.
    model: str | None = None
    #: Distance of neighbouring pixels, um.
    pixel_pitch_um: float | None = None
    #: Electrons per count, e-/DN.
    gain_e_per_dn: float | None = None
    #: Corrections that the counts have: "D" for the dark level, "F" for flats.
    corrected: str = ""
    #: What the file says in two ways, or what its counts mean otherwise than usual, for the user to decide.
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class FrameHeader:
    """Size and facts of a file of frames, read without its counts."""

    #: (height, width) of every picture, px.
    shape: tuple[int, int]
    #: Number of pictures in the file: repeats of one exposure, unless ``bands`` names them.
    pictures: int = 1
    #: What the file says of camera and lens.
    facts: FrameFacts = field(default_factory=FrameFacts)
    #: Names of the pictures where they are different bands; empty for repeats.
    bands: tuple[str, ...] = ()
    #: Whether the pictures hold floating-point values, as merged exposures do, and no counts.
    is_floating: bool = False


@dataclass(frozen=True)
class FrameReader:
    """A file format of frames: one object per format, found in its module as ``READER``."""

    #: Identifier, the name of the module.
    id: str
    #: Name of the format in messages.
    name: str
    #: Endings of file names, in small letters with the dot. The longest one that fits decides.
    suffixes: tuple[str, ...]
    #: Module of the optional package that the reader imports; None if it needs none.
    needs: str | None
    #: Size and facts of a file, without its counts. Raises InputError for a file that is no frame.
    header: Callable[[Path], FrameHeader]
    #: (n, y, x) uint16 counts of the pictures in a range of their numbers. Raises InputError for a faulty file.
    read: Callable[[Path, range], NDArray[np.uint16]]
    #: Command that installs the optional package.
    install: str = "pip install 'cboxlab[readers]'"
    #: (n, y, x) values of the pictures as they are stored; None for a format of counts alone.
    values: Callable[[Path, range], NDArray[np.float64]] | None = None


def as_counts(path: Path, values: NDArray) -> NDArray[np.uint16]:
    """Whole counts of a picture; fractions of averaged frames are rounded.

    Parameters
    ----------
    path
        The file, for messages.
    values
        (n, y, x) values of any type.

    Returns
    -------
    NDArray
        (n, y, x) counts, uint16.

    Raises
    ------
    InputError
        For values that are not finite, for fractions of full scale, and for counts outside 0 to 65535.
    """
    if values.dtype == np.uint16:
        return np.asarray(values, np.uint16)
    if not np.all(np.isfinite(values)):
        raise InputError(path, "values that are not finite", "counts")
    if np.issubdtype(values.dtype, np.floating) and 0 < values.max() <= 1:
        hint = "Multiply by the largest count of the camera before exporting."
        raise InputError(path, f"values up to {values.max():.3g}", "counts", hint)
    rounded = np.rint(values.astype(np.float64))
    if rounded.min() < 0 or rounded.max() > 65535:
        raise InputError(path, f"values from {rounded.min():g} to {rounded.max():g}", "counts of 0 to 65535")
    return rounded.astype(np.uint16)


def require_plausible_size(path: Path, shape: tuple[int, ...]) -> None:
    """Check that a file can hold the counts that its header announces.

    Parameters
    ----------
    path
        The file.
    shape
        Shape of all its pictures together.

    Raises
    ------
    InputError
        If the counts take more bytes than any packing gets into a file of that size.
    """
    size = path.stat().st_size
    unpacked = 2 * int(np.prod(shape, dtype=object))
    if unpacked > max(_MAX_UNPACKING * size, _MIN_UNPACKED_BYTES):
        hint = "The file is damaged or truncated: copy it again."
        raise InputError(path, f"{size} bytes", f"pictures of {unpacked} bytes according to its header", hint)


def positive_number(value: Any) -> float | None:
    """A number of a header, if it is above 0.

    Parameters
    ----------
    value
        A number, a text, or a pair of numerator and denominator.

    Returns
    -------
    float | None
        None for anything else, for 0 (a setting that the camera does not know), and for negative numbers.
    """
    try:
        several = value if isinstance(value, tuple) else (value, 1.0)
        over, under = (number_of(part) if isinstance(part, str) else float(part) for part in several[:2])
        number = over / under
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if np.isfinite(number) and number > 0 else None


def mosaic_pattern(path: Path, letters: NDArray[np.str_]) -> str:
    """Pattern of a mosaic in the form of ``mosaic.pattern``, with the smallest repeat.

    Parameters
    ----------
    path
        The file, for messages.
    letters
        (y, x) channel of each pixel of the upper left part of the frame, two repeats or more.

    Returns
    -------
    str
        "RGGB" for a repeat of 2 x 2; for others rows separated by a space.

    Raises
    ------
    InputError
        For other channels than R, G and B, and for a mosaic without a repeat of at most 8 x 8 pixels.
    """
    channels = set(letters.ravel().tolist())
    if channels != set("RGB"):
        description = f"a mosaic of the channels {', '.join(sorted(channels))}"
        raise InputError(path, description, "a mosaic of the channels R, G and B, or none")
    height, width = letters.shape
    for rows, columns in sorted(
        ((a, b) for a in range(2, _MAX_REPEAT + 1) for b in range(2, _MAX_REPEAT + 1)),
        key=lambda size: size[0] * size[1],
    ):
        if rows > height or columns > width:
            continue
        tiled = np.tile(letters[:rows, :columns], (-(-height // rows), -(-width // columns)))[:height, :width]
        if np.array_equal(tiled, letters):
            lines = ["".join(row) for row in letters[:rows, :columns].tolist()]
            return "".join(lines) if (rows, columns) == (2, 2) else " ".join(lines)
    raise InputError(path, "a mosaic without a repeat", f"one of at most {_MAX_REPEAT} x {_MAX_REPEAT} pixels")
