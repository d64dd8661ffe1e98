"""Camera frames: 16-bit unsigned TIFF, one channel, linear counts (DN)."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import NDArray

__all__ = ["check_frame", "read_frame"]

#: TIFF 6.0's numbers of compressions that need no further library (5: LZW), and of those by zlib.
_COMPRESSIONS, _DEFLATED = (1, 5, 8, 32773, 32946), (8, 32946)
#: The first bytes of files that are taken for frames.
_OTHERS = {
    b"\x89PNG": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"SIMPLE  ": "FITS",
    b"\x93NUMPY": "NumPy",
    b"\x89HDF": "HDF5",
    b"\x1f\x8b": "gzip",
    b"PK\x03\x04": "zip",
    b"P5": "PGM",
    b"v/1\x01": "OpenEXR",
}
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
    if (orientation := page.tags.valueof("Orientation", 1)) != 1:
        hint = "Save the frame with its first row at the top and without an orientation tag."
        raise InputError(path, f"orientation {orientation}", "orientation 1, rows as the sensor read them", hint)
    if page.compression not in _COMPRESSIONS:
        raise InputError(path, f"compression {page.compression}", "none, deflate, LZW or PackBits", _HINT)
    end = max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0)
    if end == 0 or file.filehandle.size < end:
        raise InputError(
            path,
            f"{file.filehandle.size} bytes",
            f"{end} bytes according to its header",
            "The file is truncated: copy it again.",
        )


def _require_bounded_segments(path: Path, file: tifffile.TiffFile, page: tifffile.TiffPage) -> None:
    """Raises InputError where deflated data unpack to more than the picture takes."""
    if page.compression not in _DEFLATED:
        return
    largest = int(np.prod(page.chunks)) * 2
    for offset, size in zip(page.dataoffsets, page.databytecounts, strict=True):
        file.filehandle.seek(offset)
        unpacked = zlib.decompressobj().decompress(file.filehandle.read(size), largest + 1)
        if len(unpacked) > largest:
            raise InputError(path, "packed data of more than its size", f"{largest} bytes in each strip", _HINT)


def _other_kind(path: Path) -> str | None:
    """What a file that is no TIFF is by its first bytes; None for a TIFF and for what is not known."""
    with path.open("rb") as file:
        begin = file.read(8)
    if not begin:
        return "an empty file"
    return next((f"a file of the kind {kind}" for mark, kind in _OTHERS.items() if begin.startswith(mark)), None)


def check_frame(path: Path, height: int, width: int) -> None:
    """Check that a frame exists, has one uint16 channel of that size and is complete, from its header only.

    Raises InputError with the file's name.
    """
    require_regular_file(path, "a frame that capture.toml names")
    try:
        if (kind := _other_kind(path)) is not None:
            raise InputError(path, kind, "a TIFF frame", _HINT)
        with tifffile.TiffFile(path) as file:
            _check_page(path, file, height, width)
    except InputError:
        raise
    except Exception as error:  # tifffile and its decoders raise many kinds for damaged files
        raise InputError(
            path,
            f"a file that cannot be read as TIFF ({error})",
            "a TIFF frame",
            "The file is damaged or truncated: copy it again.",
        ) from None


def read_frame(path: Path, height: int, width: int, bit_depth: int) -> NDArray[np.uint16]:
    """Counts (height, width) of a frame, uint16, 0 to 2^bit_depth - 1.

    Raises InputError with the file's name if the header does not fit or a count is out of range.
    """
    check_frame(path, height, width)
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            _require_bounded_segments(path, file, page)
            counts = page.asarray()
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            path,
            f"pixels that cannot be decoded ({error})",
            "a complete TIFF frame",
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
