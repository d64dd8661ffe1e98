"""Radiance pictures (RGBE), three channels of floating-point values.

The header states factors by which programs multiplied the light: EXPOSURE of all channels, COLORCORR of R, G and B.
Several of them multiply. The values of light are the stored ones over these factors (Ward, The Radiance picture file
format; the header's entries).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import FrameHeader, FrameReader, as_counts, require_plausible_size

#: First bytes of a Radiance picture.
_MARKS = (b"#?RADIANCE", b"#?RGBE")
#: Channels in the order of their numbers.
_CHANNELS = ("R", "G", "B")
#: Entries of the header with factors of the light, and the count of their numbers.
_FACTORS = {"EXPOSURE": 1, "COLORCORR": 3}
#: Longest header, bytes: it holds the commands that made the picture.
_LONGEST_HEADER = 65536


def _parts(path: Path) -> tuple[bytes, bytes]:
    """Entries of the header, and the bytes that follow."""
    with path.open("rb") as file:
        begin = file.read(_LONGEST_HEADER)
    if not begin.startswith(_MARKS):
        raise InputError(path, "a file that does not begin with #?RADIANCE", "a Radiance picture")
    head, _, rest = begin.partition(b"\n\n")
    return head, rest


def _factors(path: Path) -> NDArray[np.float64]:
    """(3,) factors of R, G and B by which the light was multiplied."""
    factors = np.ones(len(_CHANNELS))
    for line in _parts(path)[0].decode("latin-1").splitlines():
        key, _, text = line.partition("=")
        count = _FACTORS.get(key.strip())
        if count is None:
            continue
        try:
            numbers = np.array([float(number) for number in text.split()])
        except ValueError:
            numbers = np.zeros(0)
        if numbers.size != count or not np.isfinite(numbers).all() or (numbers <= 0).any():
            raise InputError(f"{path}: {key.strip()}", repr(text.strip()), f"{count} numbers above 0")
        factors *= numbers
    return factors


def _header(path: Path) -> FrameHeader:
    head, rest = _parts(path)
    size = rest.partition(b"\n")[0].split()
    if len(size) != 4 or size[0] != b"-Y" or size[2] != b"+X" or not (size[1] + size[3]).isdigit():
        raise InputError(path, "a picture with turned rows, or without a size", "'-Y height +X width' below its header")
    if b"FORMAT=32-bit_rle_xyze" in head:
        raise InputError(path, "X, Y, Z in place of colours", "FORMAT=32-bit_rle_rgbe")
    shape = int(size[1]), int(size[3])
    require_plausible_size(path, (len(_CHANNELS), *shape))
    return FrameHeader(shape, len(_CHANNELS), bands=_CHANNELS, is_floating=True)


def _values(path: Path, pictures: range) -> NDArray[np.float64]:
    picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 3:
        raise InputError(path, "a picture that cannot be decoded", "a Radiance picture", "Copy it again.")
    channels = np.moveaxis(np.asarray(picture, np.float64)[..., ::-1], -1, 0) / _factors(path)[:, None, None]
    return np.asarray(channels[list(pictures)], np.float64)


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    return as_counts(path, _values(path, pictures))


READER = FrameReader("hdr", "Radiance HDR", (".hdr", ".pic"), None, _header, _read, values=_values)
