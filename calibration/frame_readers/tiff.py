"""TIFF frames: 16-bit unsigned counts of one channel, one page or a stack of repeats."""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._exif import exif_facts
from ._frame_reader import EXPORT_HINT, FrameFacts, FrameHeader, FrameReader, as_counts, mosaic_pattern

#: TIFF 6.0's numbers of compressions that need no further library: none, LZW, deflate, PackBits, old deflate.
_COMPRESSIONS = (1, 5, 8, 32773, 32946)
#: Those of them by zlib, which packs without limit.
_DEFLATED = (8, 32946)
#: TIFF 6.0's photometric interpretations without counts that grow with light.
_NOT_LINEAR = {0: "WhiteIsZero: its values fall with light", 3: "a palette: its values are numbers of colours"}
#: Types of pixels of merged pictures.
_FLOATING = (np.float16, np.float32, np.float64)
#: The first bytes of files that are mistaken for TIFF frames.
_OTHER_FORMATS = {
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
_TRUNCATED_HINT = "The file is truncated: copy it again."


def _other_format(path: Path) -> str | None:
    """Format of a file that is no TIFF, by its first bytes; None if they do not show one."""
    with path.open("rb") as file:
        begin = file.read(8)
    if not begin:
        return "an empty file"
    return next((f"a file of the kind {kind}" for mark, kind in _OTHER_FORMATS.items() if begin.startswith(mark)), None)


def _require_counts(path: Path, file: tifffile.TiffFile, page: tifffile.TiffPage) -> None:
    """Raise InputError for a page that is no complete picture of 16-bit counts of one channel."""
    if page.samplesperpixel != 1 or len(page.shape) != 2:
        raise InputError(path, f"an image of shape {page.shape}", "one channel, (height, width)", EXPORT_HINT)
    if page.dtype != np.uint16 and page.dtype not in _FLOATING:
        raise InputError(path, f"pixels of type {page.dtype}", "uint16", EXPORT_HINT)
    if (meaning := _NOT_LINEAR.get(page.tags.valueof("PhotometricInterpretation", 1))) is not None:
        hint = "Save the frame with the photometric interpretation BlackIsZero, and its counts in that sense."
        raise InputError(path, meaning, "counts that grow with light, BlackIsZero", hint)
    if (orientation := page.tags.valueof("Orientation", 1)) != 1:
        hint = "Save the frame with its first row at the top and without an orientation tag."
        raise InputError(path, f"orientation {orientation}", "orientation 1, rows as the sensor read them", hint)
    if page.compression not in _COMPRESSIONS:
        raise InputError(path, f"compression {page.compression}", "none, deflate, LZW or PackBits", EXPORT_HINT)
    end = max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0)
    if end == 0 or file.filehandle.size < end:
        expected = f"{end} bytes according to its header"
        raise InputError(path, f"{file.filehandle.size} bytes", expected, _TRUNCATED_HINT)


def _virtual_pages(file: tifffile.TiffFile) -> int:
    """Pictures of a stack whose only page describes them in its text; 1 for other files."""
    if file.is_imagej:
        return int((file.imagej_metadata or {}).get("images", 1))
    shape = (file.shaped_metadata or ({},))[0].get("shape", (1, 1)) if file.is_shaped else (1, 1)
    return int(np.prod(shape[:-2], dtype=object))


def _pages(path: Path, file: tifffile.TiffFile) -> list[tifffile.TiffPage]:
    """The pages of full size, checked; previews of a reduced size are left out.

    The pages of a stack are repeats. Pages of different sizes, and channels of an OME-TIFF or ImageJ stack, are not.
    """
    first = file.pages.first
    if len(file.pages) == 1:
        _require_counts(path, file, first)
        if (count := _virtual_pages(file)) > 1:
            hint = "Save it as a TIFF of several pages."
            raise InputError(path, f"a stack of {count} pictures in one page", "a page for each picture", hint)
        return [first]
    all_pages = [file.pages[k] for k in range(len(file.pages))]
    full_pages = [page if isinstance(page, tifffile.TiffPage) else page.aspage() for page in all_pages]
    pages = [page for page in full_pages if not page.is_reduced]
    if not pages:
        raise InputError(path, "only previews", "a picture of full size", EXPORT_HINT)
    for page in pages:
        if page.shape != pages[0].shape:
            sizes = f"images of {pages[0].shape} and {page.shape} in the file"
            raise InputError(path, sizes, "repeats of one size", EXPORT_HINT)
        _require_counts(path, file, page)
    if sum(sum(page.databytecounts) for page in pages) > file.filehandle.size:
        raise InputError(path, "pages that share their bytes", "each page with data", _TRUNCATED_HINT)
    axes = dict(zip(file.series[0].axes, file.series[0].shape, strict=True)) if file.is_ome or file.is_imagej else {}
    if (channels := axes.get("C", 1)) > 1:
        hint = "Write each channel into a file: a file holds repeats of one exposure."
        raise InputError(path, f"{channels} channels in the stack", "one channel", hint)
    return pages


def _cfa_pattern(path: Path, page: tifffile.TiffPage) -> str | None:
    """Mosaic of a TIFF/EP file; None without its tags."""
    repeat, colours = page.tags.valueof(33421), page.tags.valueof(33422)
    if repeat is None or colours is None:
        return None
    letters = np.array(["RGBCMYW"[c] if c < 7 else "?" for c in bytes(colours)]).reshape(tuple(repeat))
    return mosaic_pattern(path, np.tile(letters, (2, 2)))


def _facts(path: Path, page: tifffile.TiffPage) -> FrameFacts:
    """Facts by the tags of the page and of its EXIF."""
    return replace(exif_facts(page), pattern=_cfa_pattern(path, page))


def _header(path: Path) -> FrameHeader:
    if (kind := _other_format(path)) is not None:
        raise InputError(path, kind, "a TIFF frame", EXPORT_HINT)
    with tifffile.TiffFile(path) as file:
        pages = _pages(path, file)
        height, width = pages[0].shape
        is_floating = pages[0].dtype in _FLOATING
        return FrameHeader((height, width), len(pages), _facts(path, pages[0]), is_floating=is_floating)


def _require_bounded_segments(path: Path, file: tifffile.TiffFile, page: tifffile.TiffPage) -> None:
    """Raise InputError where deflated data unpack to more than the picture takes."""
    if page.compression not in _DEFLATED or page.dtype is None:
        return
    largest = int(np.prod(page.chunks)) * np.dtype(page.dtype).itemsize
    for offset, size in zip(page.dataoffsets, page.databytecounts, strict=True):
        file.filehandle.seek(offset)
        unpacked = zlib.decompressobj().decompress(file.filehandle.read(size), largest + 1)
        if len(unpacked) > largest:
            expected = f"{largest} bytes in each strip"
            raise InputError(path, "packed data of more than its size", expected, EXPORT_HINT)


def _pictures(path: Path, pictures: range) -> NDArray:
    """(n, y, x) pixels of pages in their own type."""
    with tifffile.TiffFile(path) as file:
        pages = [_pages(path, file)[k] for k in pictures]
        for page in pages:
            _require_bounded_segments(path, file, page)
        return np.stack([page.asarray() for page in pages])


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    return as_counts(path, _pictures(path, pictures))


def _values(path: Path, pictures: range) -> NDArray[np.float64]:
    return np.asarray(_pictures(path, pictures), np.float64)


READER = FrameReader("tiff", "TIFF", (".tif", ".tiff"), None, _header, _read, values=_values)
