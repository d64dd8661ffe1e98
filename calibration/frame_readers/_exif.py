"""Facts of camera and lens by the tags of TIFF and EXIF."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import tifffile

from ._frame_reader import FrameFacts, positive_number

__all__ = ["exif_facts", "exif_facts_of_raw"]

#: Bytes 3 and 4 of a TIFF, for both orders of bytes; of raw files those of Panasonic (RW2).
_TIFF_MARKS = (b"*\0", b"\0*")


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
    """Facts by the tags of a raw file that is a kind of TIFF.

    Parameters
    ----------
    path
        The raw file.

    Returns
    -------
    FrameFacts
        Empty for another container, and for tags that cannot be read.
    """
    with path.open("rb") as file:
        if file.read(4)[2:] not in _TIFF_MARKS:
            return FrameFacts()
    try:
        with tifffile.TiffFile(path) as tagged:
            return exif_facts(tagged.pages.first)
    except Exception:  # LibRaw reads the file all the same, and states its faults
        return FrameFacts()
