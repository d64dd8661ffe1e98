"""Reads frames and their metadata from FITS, DNG and other raw files, OpenEXR stacks and TIFF.

Used only to make a first capture.toml (see ``first_manifest``): a capture itself holds only TIFF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

__all__ = ["SUFFIXES", "ForeignFrame", "read_foreign"]

_HINT = "Export it again as a one-channel 16-bit unsigned TIFF."
_RAW_SUFFIXES = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef")


@dataclass(frozen=True, eq=False)
class ForeignFrame(OwnMappings):
    """counts : (y, x) uint16 as in the file. name : the file's stem, with the channel for a stack.

    metadata : of the file, by key: exposure_s, f_number, focal_length_mm, pixel_pitch_um, gain_e_per_dn,
    filter, kind ("dark", "flat", ...), pattern (of a mosaic), white_level, model.
    """

    path: Path
    name: str
    counts: NDArray[np.uint16]
    metadata: Mapping[str, Any] = field(default_factory=dict)


def _as_counts(path: Path, values: NDArray, where: str = "") -> NDArray[np.uint16]:
    """Integer counts. Fractions (of averaged frames) are rounded; the noise model includes quantisation."""
    label = f"{path}{': ' + where if where else ''}"
    if values.ndim != 2:
        raise InputError(label, f"an image of shape {values.shape}", "one channel, (height, width)", _HINT)
    if not np.all(np.isfinite(values)):
        raise InputError(label, "values that are not finite", "counts")
    if np.issubdtype(values.dtype, np.floating) and 0 < values.max() <= 1:
        raise InputError(
            label,
            f"values up to {values.max():.3g}",
            "counts",
            "Multiply by the largest count of the camera before exporting.",
        )
    rounded = np.rint(values.astype(np.float64))
    if rounded.min() < 0 or rounded.max() > 65535:
        raise InputError(label, f"values from {rounded.min():g} to {rounded.max():g}", "counts of 0 to 65535")
    return rounded.astype(np.uint16)


def _needs(path: Path, package: str) -> InputError:
    return InputError(
        path,
        f"a file that needs the package {package} to be read",
        "that package installed",
        "pip install 'cboxlab[readers]'",
    )


def _number(value: Any) -> float | None:
    try:
        number = float(value[0]) / float(value[1]) if isinstance(value, tuple) else float(value)
    except (TypeError, ValueError, IndexError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) and number > 0 else None


def _known(**found: Any) -> dict[str, Any]:
    return {key: value for key, value in found.items() if value not in (None, "")}


def _read_tiff(path: Path) -> Iterator[ForeignFrame]:
    with tifffile.TiffFile(path) as file:
        page = file.pages.first
        tags = {name: tag.value for name, tag in ((t.name, t) for t in page.tags)}
        exif = tags.get("ExifTag") or {}
        exif = exif if isinstance(exif, dict) else {}
        metadata = _known(
            exposure_s=_number(tags.get("ExposureTime", exif.get("ExposureTime"))),
            f_number=_number(tags.get("FNumber", exif.get("FNumber"))),
            focal_length_mm=_number(tags.get("FocalLength", exif.get("FocalLength"))),
            model=tags.get("Model"),
        )
        if page.dtype != np.uint16:
            raise InputError(path, f"pixels of type {page.dtype}", "uint16", _HINT)
        yield ForeignFrame(path, path.stem, _as_counts(path, np.asarray(file.asarray())), metadata)


def _read_fits(path: Path) -> Iterator[ForeignFrame]:
    try:
        from astropy.io import fits
    except ImportError:
        raise _needs(path, "astropy") from None
    with fits.open(path, memmap=False) as file:
        images = [unit for unit in file if unit.data is not None and unit.data.ndim >= 2]
        if len(images) != 1:
            raise InputError(path, f"{len(images)} images in the file", "one image")
        unit, header = images[0], images[0].header
        first = file[0].header

        def get(*keys: str) -> Any:
            return next((h[k] for k in keys for h in (header, first) if k in h), None)

        # FITS rows start at the bottom unless ROWORDER says otherwise.
        data = np.asarray(unit.data)
        data = data if str(get("ROWORDER") or "").upper() == "TOP-DOWN" else data[::-1]
        metadata = _known(
            exposure_s=_number(get("EXPTIME", "EXPOSURE")),
            f_number=_number(get("FOCRATIO")),
            focal_length_mm=_number(get("FOCALLEN")),
            pixel_pitch_um=_number(get("XPIXSZ", "PIXSIZE1")),
            gain_e_per_dn=_number(get("EGAIN")),
            filter=str(get("FILTER") or "").strip(),
            kind=str(get("IMAGETYP", "FRAME") or "").strip().lower(),
            pattern=str(get("BAYERPAT") or "").strip().upper(),
            model=str(get("INSTRUME") or "").strip(),
        )
        yield ForeignFrame(path, path.stem, _as_counts(path, data), metadata)


def _read_raw(path: Path) -> Iterator[ForeignFrame]:
    try:
        import rawpy
    except ImportError:
        raise _needs(path, "rawpy") from None
    with rawpy.imread(str(path)) as raw:
        pattern = None
        if raw.raw_pattern is not None and raw.raw_pattern.shape == (2, 2):
            letters = raw.color_desc.decode("ascii", "replace")
            pattern = "".join(letters[i] for i in raw.raw_pattern.ravel())
        other = raw.other
        metadata = _known(
            exposure_s=_number(other.shutter_speed),
            f_number=_number(other.aperture),
            focal_length_mm=_number(other.focal_length),
            pattern=pattern,
            white_level=_number(raw.white_level),
        )
        yield ForeignFrame(path, path.stem, _as_counts(path, raw.raw_image_visible.copy()), metadata)


def _read_exr(path: Path) -> Iterator[ForeignFrame]:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        if not channels:
            raise InputError(path, "no channels", "one channel per band")
        for name, channel in channels.items():
            counts = _as_counts(path, np.asarray(channel.pixels), name)
            metadata = _known(filter=name if len(channels) > 1 else None)
            yield ForeignFrame(path, f"{path.stem}-{name}" if len(channels) > 1 else path.stem, counts, metadata)


_READERS: dict[str, Callable[[Path], Iterator[ForeignFrame]]] = {
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".fits": _read_fits,
    ".fit": _read_fits,
    ".fts": _read_fits,
    ".exr": _read_exr,
    **dict.fromkeys(_RAW_SUFFIXES, _read_raw),
}

#: File name endings that can be read.
SUFFIXES = tuple(_READERS)


def read_foreign(path: Path) -> list[ForeignFrame]:
    """The frames of a file: one, or one per channel of an OpenEXR stack.

    Raises InputError with the file's name for an unknown ending, a damaged file, an image of several channels,
    values that are not counts of 0 to 65535, or a package that is not installed.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(path, "no such file", "a frame")
    try:
        return list(reader(path))
    except InputError:
        raise
    except Exception as error:  # each library raises its own exceptions for damaged files
        raise InputError(
            path, f"a file that cannot be read ({error})", f"a {path.suffix} frame", "Copy it again."
        ) from None
