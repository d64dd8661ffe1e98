"""Camera frames: 16-bit unsigned TIFF, one channel, linear counts (DN)."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray

__all__ = ["check_frame", "read_frame"]

_UNREADABLE = (
    OSError,
    ValueError,
    IndexError,
    KeyError,
    TypeError,
    RuntimeError,
    zlib.error,
    tifffile.TiffFileError,
)
_HINT = "Export it again as a one-channel 16-bit unsigned TIFF."


def _check_page(path: Path, file: tifffile.TiffFile, height: int, width: int) -> None:
    if len(file.pages) != 1:
        raise InputError(path, f"{len(file.pages)} images in the file", "one image", _HINT)
    page = file.pages.first
    if page.samplesperpixel != 1 or len(page.shape) != 2:
        raise InputError(path, f"an image of shape {page.shape}", f"one channel, ({height}, {width})", _HINT)
    if page.dtype != np.uint16:
        raise InputError(path, f"pixels of type {page.dtype}", "uint16", _HINT)
    if page.shape != (height, width):
        raise InputError(
            path,
            f"{page.shape[1]} x {page.shape[0]} pixels (width x height)",
            f"{width} x {height} as in [camera] of capture.toml",
        )
    end = max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0)
    if end == 0 or file.filehandle.size < end:
        raise InputError(
            path,
            f"{file.filehandle.size} bytes",
            f"{end} bytes by its own header",
            "The file is truncated: copy it again.",
        )


def check_frame(path: Path, height: int, width: int) -> None:
    """Check a frame by its header alone: existence, one uint16 channel, size, all its bytes present.

    Raises InputError naming the file.
    """
    if not path.is_file():
        raise InputError(path, "no such file", "a frame that capture.toml names")
    try:
        with tifffile.TiffFile(path) as file:
            _check_page(path, file, height, width)
    except InputError:
        raise
    except _UNREADABLE as error:
        raise InputError(
            path,
            f"a file that cannot be read as TIFF ({error})",
            "a TIFF frame",
            "The file is damaged or truncated: copy it again.",
        ) from None


def read_frame(path: Path, height: int, width: int, bit_depth: int) -> NDArray[np.uint16]:
    """Counts (height, width) of a frame, uint16, 0 to 2^bit_depth - 1.

    Raises InputError naming the file where the header or a count is out of these bounds.
    """
    check_frame(path, height, width)
    try:
        counts = tifffile.imread(path)
    except _UNREADABLE as error:
        raise InputError(
            path,
            f"pixels that cannot be decoded ({error})",
            "a whole TIFF frame",
            "The file is damaged or truncated: copy it again.",
        ) from None
    limit = 2**bit_depth - 1
    if counts.max() > limit:
        raise InputError(
            path,
            f"a count of {counts.max()}",
            f"0 to {limit} (bit_depth = {bit_depth})",
            "Store counts in the lower bits, or correct bit_depth in capture.toml.",
        )
    return np.asarray(counts, np.uint16)
