"""Radiance pictures (RGBE), three channels of floating-point values."""

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
#: Longest header, bytes: it holds the commands that made the picture.
_LONGEST_HEADER = 65536


def _header(path: Path) -> FrameHeader:
    with path.open("rb") as file:
        begin = file.read(_LONGEST_HEADER)
    if not begin.startswith(_MARKS):
        raise InputError(path, "a file that does not begin with #?RADIANCE", "a Radiance picture")
    head, _, rest = begin.partition(b"\n\n")
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
    channels = np.moveaxis(np.asarray(picture, np.float64)[..., ::-1], -1, 0)
    return channels[list(pictures)]


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    return as_counts(path, _values(path, pictures))


READER = FrameReader("hdr", "Radiance HDR", (".hdr", ".pic"), None, _header, _read, values=_values)
