"""Facts of camera and lens by the tags of TIFF and EXIF."""

from __future__ import annotations

import io
import logging
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import tifffile

from ._frame_reader import FrameFacts, positive_number

__all__ = ["exif_facts", "exif_facts_of_raw"]

#: Bytes 3 and 4 of a TIFF, for both orders of bytes, and of raw files like it: of Panasonic (RW2) and Olympus (ORF).
_TIFF_MARKS = (b"*\0", b"\0*", b"U\0", b"RO", b"RS", b"OR", b"SR")
#: Marks before a TIFF within another container, and the bytes between: CR3 has two, RAF a JPEG, MRW a block.
_CONTAINERS = ((b"CMT1", 0), (b"CMT2", 0), (b"Exif\0\0", 0), (b"\0TTW", 4))
#: Bytes of a raw file in which its tags lie.
_LOOKED_AT_BYTES = 2**18


def _exif_time(tags: dict[str, Any]) -> datetime | None:
    """Moment of the exposure by EXIF, with its fraction of a second; None if not stated."""
    text = str(tags.get("DateTimeOriginal") or "").strip("\0 ")
    fraction = str(tags.get("SubsecTimeOriginal") or tags.get("SubSecTimeOriginal") or "").strip("\0 ")
    try:
        moment = datetime.strptime(text, "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    return moment.replace(microsecond=int(f"{fraction[:6]:0<6}")) if fraction.isdigit() else moment


def exif_facts(page: tifffile.TiffPage) -> FrameFacts:
    """Facts by the tags of a page and of its EXIF.

    Parameters
    ----------
    page
        First page of a file.

    Returns
    -------
    FrameFacts
        Without a mosaic.
    """
    exif = page.tags.valueof("ExifTag")
    tags = {**(exif if isinstance(exif, dict) else {}), **{tag.name: tag.value for tag in page.tags}}
    iso = tags.get("ISOSpeedRatings", tags.get("PhotographicSensitivity"))
    model = tags.get("Model")
    return FrameFacts(
        exposure_s=positive_number(tags.get("ExposureTime")),
        f_number=positive_number(tags.get("FNumber")),
        iso=positive_number(iso[0] if isinstance(iso, tuple) and iso else iso),
        focal_length_mm=positive_number(tags.get("FocalLength")),
        time=_exif_time(tags),
        model=model.strip("\0 ") or None if isinstance(model, str) else None,
    )


def exif_facts_of_raw(path: Path) -> FrameFacts:
    """Facts by the tags of a raw file, which is a kind of TIFF or holds one.

    Parameters
    ----------
    path
        The raw file.

    Returns
    -------
    FrameFacts
        Empty where no tags are found, and for tags that cannot be read.
    """
    with path.open("rb") as file:
        begin = file.read(_LOOKED_AT_BYTES)
    if begin[2:4] in _TIFF_MARKS:
        return _facts_of_tiff(path)
    facts = FrameFacts()
    for mark, skipped in _CONTAINERS:
        start = begin.find(mark)
        if start >= 0:
            inner = _facts_of_tiff(io.BytesIO(begin[start + len(mark) + skipped :]))
            lacking = {f.name: getattr(inner, f.name) for f in fields(facts) if getattr(facts, f.name) is None}
            facts = replace(facts, **lacking)
    return facts


def _facts_of_tiff(file: Path | io.BytesIO) -> FrameFacts:
    """Facts of the first page; empty where it cannot be read."""
    log = logging.getLogger("tifffile")
    before, log.disabled = log.disabled, True  # it warns of pictures that it cannot decode, which LibRaw does
    try:
        with tifffile.TiffFile(file) as tagged:
            return exif_facts(tagged.pages.first)
    except Exception:  # LibRaw reads the file all the same, and states its faults
        return FrameFacts()
    finally:
        log.disabled = before
