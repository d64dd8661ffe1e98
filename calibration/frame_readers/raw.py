"""Camera raw files (DNG, CR2, NEF ...) by LibRaw, as counts of the mosaic."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._exif import exif_facts_of_raw
from ._frame_reader import FrameFacts, FrameHeader, FrameReader, as_counts, mosaic_pattern, positive_number

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
    ".sr2",
    ".srf",
    ".rwl",
    ".mrw",
    ".crw",
    ".kdc",
    ".dcr",
    ".mef",
    ".mos",
    ".fff",
    ".gpr",
    ".x3f",
)
#: Rows and columns over which the mosaic is looked at: two repeats of the largest one.
_LOOKED_AT_PX = 16
#: Columns or rows next to the border of the masked pixels that are left out: light and charge reach across it, px.
_BORDER_PX = 4
#: Masked columns or rows that give a black level, at least, px.
_MASKED_PX = 8
#: Range of masked counts, 1st to 99th of 100, over the white level, at most: beyond it they have seen light.
_MASKED_RANGE = 0.02
#: Counts other than 0 that the empty rows at the end of a picture would have as its others have, at most: with more,
#: chance empties one file in a thousand million. LibRaw reads some truncated files so, without a word.
_CHANCE_COUNTS = 20.0
#: LibRaw's moment of a file that states none.
_NO_TIME = datetime(1970, 1, 2)


def _require_mosaic(path: Path, raw: Any) -> None:
    """Raise InputError for a file whose pixels hold several colours each, such as a linear DNG."""
    import rawpy

    if raw.raw_type != rawpy.RawType.Flat:
        hint = "Use the camera's file before conversion."
        raise InputError(path, "several colours in each pixel", "one count in each pixel", hint)
    if raw.raw_image_visible.shape != (raw.sizes.height, raw.sizes.width):
        raise InputError(path, "a sensor whose rows of pixels run diagonally", "rows and columns of pixels")


def _require_last_rows(path: Path, counts: NDArray[np.uint16]) -> None:
    """Raise InputError for a picture that ends in rows of zeros."""
    filled_rows = np.flatnonzero(counts.any(axis=1))
    last = int(filled_rows[-1]) if filled_rows.size else len(counts) - 1
    if (counts[: last + 1] > 0).mean() * counts[last + 1 :].size > _CHANCE_COUNTS:
        fault = f"a picture without counts below row {last} of {len(counts)}"
        raise InputError(path, fault, "counts in all rows", "The file is truncated: copy it again.")


def _single_precision(value: float) -> float | None:
    """Number that LibRaw keeps in single precision, in as many digits, if it is above 0."""
    number = positive_number(value)
    return None if number is None else float(f"{number:.7g}")


def _numbers(raw: Any) -> list[list[int]]:
    """LibRaw's numbers of the channels in the upper left part of the visible pixels, row by row."""
    sizes = raw.sizes
    rows, columns = min(_LOOKED_AT_PX, sizes.height), min(_LOOKED_AT_PX, sizes.width)
    top, left_margin = sizes.top_margin, sizes.left_margin
    return [[raw.raw_color(top + v, left_margin + u) for u in range(columns)] for v in range(rows)]


def _pattern(path: Path, raw: Any) -> str | None:
    """Mosaic from the first visible pixel on; None for a monochrome sensor."""
    names = raw.color_desc.decode("ascii", "replace")
    if raw.raw_pattern is None or raw.num_colors == 1:
        return None
    return mosaic_pattern(path, np.array([[names[number] for number in row] for row in _numbers(raw)]))


def _masked_levels(raw: Any) -> list[float] | None:
    """Mean count of the pixels under the sensor's mask, by LibRaw's number of the channel.

    None for a sensor without them, and where they may have seen light.
    """
    top, left_margin = raw.sizes.top_margin, raw.sizes.left_margin
    rows, columns = (slice(top, None), slice(_BORDER_PX, left_margin - _BORDER_PX))
    if columns.stop - columns.start < _MASKED_PX:
        rows, columns = slice(_BORDER_PX, top - _BORDER_PX), slice(left_margin, None)
        if rows.stop - rows.start < _MASKED_PX:
            return None
    counts, channel = raw.raw_image[rows, columns], raw.raw_colors[rows, columns]
    low, high = np.percentile(counts, [1, 99])
    brighter_than_scene = np.median(counts) > np.median(raw.raw_image_visible) + 1
    if high - low > _MASKED_RANGE * raw.white_level or brighter_than_scene:
        return None
    inside = (counts >= low) & (counts <= high)
    number = len(raw.black_level_per_channel)
    return [float(counts[inside & (channel == c)].mean()) if (channel == c).any() else 0.0 for c in range(number)]


def _black_level(raw: Any, pattern: str | None) -> dict[str, float]:
    """Black level by channel. Where two greens differ, the second one in reading order is "G2".

    Where the metadata state 0, the masked pixels give it.
    """
    levels = [float(level) for level in raw.black_level_per_channel]
    if not any(levels) and (masked := _masked_levels(raw)) is not None:
        levels = [round(level, 1) for level in masked]
    if pattern is None:
        return {"": levels[0]}
    by_channel: dict[str, float] = {}
    names = raw.color_desc.decode("ascii", "replace")
    for number in dict.fromkeys(number for row in _numbers(raw) for number in row):
        if by_channel.setdefault(names[number], levels[number]) != levels[number]:
            by_channel[f"{names[number]}2"] = levels[number]
    return by_channel


def _header(path: Path) -> FrameHeader:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        _require_mosaic(path, raw)
        pattern, other, tags = _pattern(path, raw), raw.other, exif_facts_of_raw(path)
        # tags are exact, but for high sensitivities, which do not fit into theirs
        facts = FrameFacts(
            exposure_s=tags.exposure_s or _single_precision(other.shutter_speed),
            f_number=tags.f_number or _single_precision(other.aperture),
            iso=_single_precision(other.iso_speed) or tags.iso,
            black_level=_black_level(raw, pattern),
            white_level=positive_number(raw.white_level),
            pattern=pattern,
            focal_length_mm=tags.focal_length_mm or _single_precision(other.focal_length),
            time=tags.time or (other.timestamp if other.timestamp >= _NO_TIME else None),
            model=tags.model,
        )
        return FrameHeader((raw.sizes.height, raw.sizes.width), 1, facts)


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        _require_mosaic(path, raw)
        counts = as_counts(path, raw.raw_image_visible.copy()[None])
        _require_last_rows(path, counts[0])
        return counts


READER = FrameReader("raw", "camera raw", _SUFFIXES, "rawpy", _header, _read)
