"""FITS frames: an image or a cube of repeats, also packed by gzip or in tiles (.fz)."""

from __future__ import annotations

import gzip
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.limits import MAX_PACKED_BYTES, require_size
from numpy.typing import NDArray

from ._frame_reader import (
    FrameFacts,
    FrameHeader,
    FrameReader,
    as_counts,
    mosaic_pattern,
    positive_number,
    require_plausible_size,
)

_SUFFIXES = tuple(f"{stem}{packed}" for stem in (".fits", ".fit", ".fts") for packed in ("", ".gz", ".fz"))

#: Bytes of a block of FITS; headers and data fill whole blocks.
_BLOCK = 2880
#: Bytes of a header, at most: real ones have some tens of thousands.
_MAX_HEADER_BYTES = 2**20
#: Headers of a file, at most.
_MAX_HEADERS = 64
#: Names of no filter.
_NO_FILTER = frozenset({"", "none", "no filter", "no_filter", "nofilter", "n/a", "unknown", "-"})
#: Seconds as a text: a number, or a fraction as a camera displays it.
_TEXT_OF_SECONDS = re.compile(r"\s*(\d+(?:[.,]\d+)?)(?:\s*/\s*(\d+))?\s*(?:s|sec)?\s*")
#: Corrections in lines of HISTORY, by their letter.
_IN_HISTORY = {
    "D": r"dark[\w -]*(?:corrected|subtract)|subtract\w*[\w -]*dark|(?<!\w)minus [\w -]*dark",
    "F": r"flat[\w -]*(?:corrected|divid)|divid\w*[\w -]*flat",
}
#: Largest relative difference of EXPTIME and EXPOSURE that is rounding.
_SAME_EXPOSURE = 0.01
#: Bytes skipped at a time in a packed file.
_CHUNK = 2**20
#: Zeros after a packed file, bytes: the library reads each of them alone. Tapes have up to 10 KiB.
_MAX_PADDING = 2**16


def _cards(path: Path, stream: IO[bytes] | gzip.GzipFile) -> dict[str, str]:
    """Keywords and values of the next header; empty at the end of the file.

    Raises InputError for a header without end.
    """
    cards: dict[str, str] = {}
    for count in range(_MAX_HEADER_BYTES // _BLOCK):
        block = stream.read(_BLOCK)
        if len(block) < _BLOCK:
            if count == 0 and not block.strip(b"\0 "):
                return {}
            break
        for start in range(0, _BLOCK, 80):
            card = block[start : start + 80].decode("latin-1")
            if not count and not start and not card.startswith(("SIMPLE  =", "XTENSION=")):
                raise InputError(path, "bytes that are no header of FITS", "a FITS frame")
            if card.rstrip() == "END":
                return cards
            cards.setdefault(card[:8].rstrip(), card[10:].partition("/")[0].strip())
    hint = "The file is damaged or truncated: copy it again."
    raise InputError(path, "a header without end", "a FITS frame", hint)


def _data_bytes(path: Path, cards: dict[str, str]) -> int:
    """Bytes of data after a header, without the padding of their last block."""
    try:
        axes = [int(cards[f"NAXIS{k + 1}"]) for k in range(int(cards["NAXIS"]))]
        values = int(np.prod(axes, dtype=object)) if axes else 0
        size = abs(int(cards["BITPIX"])) // 8 * int(cards.get("GCOUNT", 1)) * (int(cards.get("PCOUNT", 0)) + values)
    except (KeyError, ValueError):
        raise InputError(path, "a header without NAXIS and BITPIX", "a FITS frame") from None
    if min([*axes, size]) < 0:
        raise InputError(path, "a negative size in a header", "a FITS frame")
    return size


def _require_short_padding(path: Path) -> None:
    """Raise InputError for a packed file that is too large, or ends in many zeros."""
    size = path.stat().st_size
    require_size(path, size, MAX_PACKED_BYTES, "bytes of compressed data")
    with path.open("rb") as stream:
        stream.seek(max(size - _MAX_PADDING, 0))
        end = stream.read()
    if len(end) == _MAX_PADDING and not any(end):
        hint = "The file is damaged or was not written to its end: copy it again."
        raise InputError(path, f"more than {_MAX_PADDING} zeros at the end", "compressed data to the end", hint)


def _require_sound_headers(path: Path) -> None:
    """Raise InputError for headers that a library would read without end, and for missing data."""
    packed = path.suffix.lower() == ".gz"
    bytes_of_file = path.stat().st_size
    if packed:
        _require_short_padding(path)
    with gzip.open(path, "rb") if packed else path.open("rb") as stream:
        for _ in range(_MAX_HEADERS):
            cards = _cards(path, stream)
            if not cards:
                return
            unpadded = _data_bytes(path, cards)
            size = -(-unpadded // _BLOCK) * _BLOCK
            if packed:
                require_size(path, size, MAX_PACKED_BYTES, "bytes of compressed data")
            if not packed:
                if bytes_of_file < (end := stream.tell() + unpadded):
                    expected = f"{end} bytes according to its header"
                    raise InputError(path, f"{bytes_of_file} bytes", expected, "The file is truncated: copy it again.")
                stream.seek(size, 1)
                continue
            while size > 0 and (chunk := stream.read(min(size, _CHUNK))):
                size -= len(chunk)
    raise InputError(path, f"more than {_MAX_HEADERS} headers", "one image or cube")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The image of a file and the file's first header, which holds what the image's does not."""
    from astropy.io import fits  # slow to import, and an optional package

    _require_sound_headers(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy warns of what is checked below
        with fits.open(path, memmap=False) as file:
            images = [unit for unit in file if unit.is_image and len(unit.shape) >= 2]
            if len(images) != 1:
                hint = "Repeats are the planes of one cube, or separate files."
                raise InputError(path, f"{len(images)} images in the file", "one image or cube", hint)
            yield images[0], file[0].header


def _require_complete(path: Path, unit: Any) -> None:
    """Raise InputError for a compressed file that is too small for its image."""
    from astropy.io import fits

    # a file of any ending may hold a compressed image
    if path.suffix.lower() in (".gz", ".fz") or isinstance(unit, fits.CompImageHDU):
        require_plausible_size(path, unit.shape)


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
    return mosaic_pattern(path, np.tile(np.roll(letters, (-offset[0], -offset[1]), (0, 1)), (2, 2)))


def _time(text: str) -> datetime | None:
    """Moment of DATE-OBS without time zone; None for anything else than date and time."""
    try:
        return datetime.fromisoformat(text.strip()).replace(tzinfo=None) if "T" in text else None
    except ValueError:
        return None


def _corrected(*headers: Any) -> str:
    """Corrections by the lines of HISTORY, as ``FrameFacts.corrected``."""
    history = "\n".join(str(line) for header in headers for line in header.get("HISTORY", []))
    return "".join(letter for letter, pattern in _IN_HISTORY.items() if re.search(pattern, history, re.I))


def _seconds(value: Any) -> float | None:
    """Seconds of a card, also of a text such as '1/60' or '0.5 s'."""
    match = _TEXT_OF_SECONDS.fullmatch(value) if isinstance(value, str) else None
    return positive_number(value if match is None else (match[1].replace(",", "."), match[2] or "1"))


def _exposure(exptime: float | None, exposure: float | None) -> tuple[float | None, tuple[str, ...]]:
    """Exposure by two keywords, s, and a doubt where they differ; then it is None."""
    if exptime is None or exposure is None or np.isclose(exptime, exposure, rtol=_SAME_EXPOSURE):
        return exptime or exposure, ()
    return None, (f"EXPTIME is {exptime:g} s and EXPOSURE {exposure:g} s: state the exposure of one picture",)


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
        exposure_s, doubts = _exposure(_seconds(get("EXPTIME")), _seconds(get("EXPOSURE")))
        pedestal, filter_name = get("PEDESTAL"), text("FILTER")
        if isinstance(pedestal, int | float) and pedestal:
            doubts += (f"PEDESTAL is {pedestal:g}: without light the frames show {-pedestal:g} DN; subtract them",)
        facts = FrameFacts(
            exposure_s=exposure_s,
            f_number=f_number,
            iso=positive_number(get("ISOSPEED")),
            pattern=_pattern(path, text("BAYERPAT").upper(), shift),
            focal_length_mm=positive_number(get("FOCALLEN")),
            time=_time(text("DATE-OBS")),
            kind=text("IMAGETYP", "FRAME").lower() or None,
            filter=None if filter_name.lower() in _NO_FILTER else filter_name,
            model=text("INSTRUME") or None,
            pixel_pitch_um=positive_number(get("XPIXSZ", "PIXSIZE1")),
            gain_e_per_dn=positive_number(get("EGAIN")),
            corrected=text("CALSTAT").upper() or _corrected(unit.header, first),
            doubts=doubts,
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
