"""FITS frames: an image or a cube of repeats, also packed by gzip or in tiles (.fz)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import (
    FrameFacts,
    FrameHeader,
    FrameReader,
    as_counts,
    pattern_of,
    positive_number,
    require_plausible_size,
)

_SUFFIXES = tuple(f"{stem}{packed}" for stem in (".fits", ".fit", ".fts") for packed in ("", ".gz", ".fz"))


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The image of a file and the file's first header, which holds what the image's does not."""
    from astropy.io import fits  # slow to import, and an optional package

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy warns of what is checked below
        with fits.open(path, memmap=False) as file:
            images = [unit for unit in file if unit.is_image and len(unit.shape) >= 2]
            if len(images) != 1:
                hint = "Repeats are the planes of one cube, or separate files."
                raise InputError(path, f"{len(images)} images in the file", "one image or cube", hint)
            yield images[0], file[0].header


def _require_complete(path: Path, unit: Any) -> None:
    """Raise InputError for a file that ends before its image."""
    if path.suffix.lower() in (".gz", ".fz"):
        require_plausible_size(path, unit.shape)
        return
    end = unit.fileinfo()["datLoc"] + abs(unit.header["BITPIX"]) // 8 * int(np.prod(unit.shape, dtype=object))
    if (size := path.stat().st_size) < end:
        expected = f"{end} bytes according to its header"
        raise InputError(path, f"{size} bytes", expected, "The file is truncated: copy it again.")


def _cube_shape(path: Path, unit: Any) -> tuple[int, int, int]:
    """(n, height, width) of an image or cube; further axes may only have the length 1."""
    shape = unit.shape
    while len(shape) > 3 and shape[0] == 1:
        shape = shape[1:]
    if len(shape) > 3 or 0 in shape:
        raise InputError(path, f"an image of shape {unit.shape}", "(height, width) or (repeats, height, width)")
    return shape if len(shape) == 3 else (1, *shape)


def _is_top_down(value: Any) -> bool:
    """Whether rows start at the top; they start at the bottom unless ROWORDER says otherwise."""
    return str(value or "").strip().upper() == "TOP-DOWN"


def _pattern(path: Path, text: str, offset: tuple[int, int]) -> str | None:
    """Mosaic by BAYERPAT, with the first pixel at ``offset`` (row, column) of the repeat.

    The pattern is that of the picture as displayed, its first row at the top. A text of 36 letters is 6 x 6.
    """
    side = {4: 2, 36: 6}.get(len(text))
    if text in ("", "NONE"):
        return None
    if side is None:
        raise InputError(f"{path}: BAYERPAT", f"'{text}'", "4 letters (2 x 2) or 36 letters (6 x 6)")
    letters = np.array(list(text)).reshape(side, side)
    return pattern_of(path, np.tile(np.roll(letters, (-offset[0], -offset[1]), (0, 1)), (2, 2)))


def _time(text: str) -> datetime | None:
    """Moment of DATE-OBS without time zone; None for anything else than date and time."""
    try:
        return datetime.fromisoformat(text.strip()).replace(tzinfo=None) if "T" in text else None
    except ValueError:
        return None


def _header(path: Path) -> FrameHeader:
    with _opened(path) as (unit, first):
        _require_complete(path, unit)
        pictures, height, width = _cube_shape(path, unit)

        def get(*keys: str) -> Any:
            return next((h[k] for k in keys for h in (unit.header, first) if k in h), None)

        def text(*keys: str) -> str:
            return str(get(*keys) or "").strip()

        def offset(*keys: str) -> int:
            value = get(*keys)
            return int(value) if isinstance(value, int | float) else 0

        f_number = positive_number(get("FOCRATIO", "F-NUMBER", "FNUMBER"))
        shift = offset("YBAYROFF", "BAYOFFY"), offset("XBAYROFF", "BAYOFFX")
        facts = FrameFacts(
            exposure_s=positive_number(get("EXPTIME", "EXPOSURE")),
            f_number=f_number,
            iso=positive_number(get("ISOSPEED")),
            pattern=_pattern(path, text("BAYERPAT").upper(), shift),
            focal_length_mm=positive_number(get("FOCALLEN")),
            time=_time(text("DATE-OBS")),
            kind=text("IMAGETYP", "FRAME").lower() or None,
            filter=text("FILTER") or None,
            model=text("INSTRUME") or None,
            pixel_pitch_um=positive_number(get("XPIXSZ", "PIXSIZE1")),
            gain_e_per_dn=positive_number(get("EGAIN")),
        )
        return FrameHeader((height, width), pictures, facts)


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    with _opened(path) as (unit, first):
        _require_complete(path, unit)
        count, height, width = _cube_shape(path, unit)
        if count == 1:
            planes = np.asarray(unit.data).reshape(1, height, width)
        else:  # planes of the cube on disk, not the whole cube
            before = (0,) * (len(unit.shape) - 3)
            planes = np.stack([np.asarray(unit.section[(*before, k)]) for k in pictures])
        top_down = _is_top_down(unit.header.get("ROWORDER", first.get("ROWORDER")))
        return as_counts(path, np.ascontiguousarray(planes if top_down else planes[:, ::-1]))


READER = FrameReader("fits", "FITS", _SUFFIXES, "astropy", _header, _read)
