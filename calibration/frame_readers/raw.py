"""Camera raw files (DNG, CR2, NEF ...) by LibRaw, as counts of the mosaic."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import FrameFacts, FrameHeader, FrameReader, as_counts, pattern_of, positive_number

_SUFFIXES = (
    ".dng",
    ".nef",
    ".nrw",
    ".cr2",
    ".cr3",
    ".arw",
    ".raf",
    ".orf",
    ".rw2",
    ".pef",
    ".srw",
    ".iiq",
    ".3fr",
    ".erf",
)
#: Rows and columns over which the mosaic is looked at: two repeats of the largest one.
_LOOKED_AT_PX = 16
#: LibRaw's moment of a file that states none.
_NO_TIME = datetime(1970, 1, 2)


def _require_mosaic(path: Path, raw: Any) -> None:
    """Raise InputError for a file whose pixels hold several colours each, such as a linear DNG."""
    import rawpy

    if raw.raw_type != rawpy.RawType.Flat:
        hint = "Use the camera's file before conversion."
        raise InputError(path, "several colours in each pixel", "one count in each pixel", hint)


def _pattern(path: Path, raw: Any) -> str | None:
    """Mosaic from the first visible pixel on; None for a monochrome sensor."""
    names = raw.color_desc.decode("ascii", "replace")
    if raw.raw_pattern is None or raw.num_colors == 1:
        return None
    sizes = raw.sizes
    rows, columns = min(_LOOKED_AT_PX, sizes.height), min(_LOOKED_AT_PX, sizes.width)
    top, left_margin = sizes.top_margin, sizes.left_margin
    letters = [[names[raw.raw_color(top + v, left_margin + u)] for u in range(columns)] for v in range(rows)]
    return pattern_of(path, np.array(letters))


def _black_level(raw: Any, pattern: str | None) -> dict[str, float]:
    """Black level by channel. Where two greens differ, the second one is "G2"."""
    levels = [float(level) for level in raw.black_level_per_channel]
    if pattern is None:
        return {"": levels[0]}
    by_channel: dict[str, float] = {}
    for name, level in zip(raw.color_desc.decode("ascii", "replace"), levels, strict=False):
        if by_channel.setdefault(name, level) != level:
            by_channel[f"{name}2"] = level
    return by_channel


def _header(path: Path) -> FrameHeader:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        _require_mosaic(path, raw)
        pattern, other = _pattern(path, raw), raw.other
        facts = FrameFacts(
            exposure_s=positive_number(other.shutter_speed),
            f_number=positive_number(other.aperture),
            iso=positive_number(other.iso_speed),
            black_level=_black_level(raw, pattern),
            white_level=positive_number(raw.white_level),
            pattern=pattern,
            focal_length_mm=positive_number(other.focal_length),
            time=other.timestamp if other.timestamp >= _NO_TIME else None,
        )
        return FrameHeader((raw.sizes.height, raw.sizes.width), 1, facts)


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        _require_mosaic(path, raw)
        return as_counts(path, raw.raw_image_visible.copy()[None])


READER = FrameReader("raw", "camera raw", _SUFFIXES, "rawpy", _header, _read)
