"""PNG frames: counts of 16 bits in one channel, as programs of industrial cameras save them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import EXPORT_HINT, FrameHeader, FrameReader, as_counts, require_plausible_size

_MARK = b"\x89PNG\r\n\x1a\n"
#: Bits of a count, and the number of a picture in grey, in PNG's header.
_COUNTS_IN_GREY = (16, 0)


def _header(path: Path) -> FrameHeader:
    with path.open("rb") as file:
        head = file.read(26)
    if len(head) < 26 or not head.startswith(_MARK):
        raise InputError(path, "a file that does not begin as PNG" if head else "an empty file", "a PNG", EXPORT_HINT)
    width, height = (int.from_bytes(head[k : k + 4], "big") for k in (16, 20))
    if (head[24], head[25]) != _COUNTS_IN_GREY:
        raise InputError(path, f"{head[24]} bits of a developed picture", "16 bits in grey", EXPORT_HINT)
    require_plausible_size(path, (1, height, width))
    return FrameHeader((height, width))


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 2 or path.read_bytes()[-8:-4] != b"IEND":
        raise InputError(path, "a picture that cannot be decoded", "a complete PNG", "Copy it again.")
    return as_counts(path, np.asarray(picture)[None][list(pictures)])


READER = FrameReader("png", "PNG", (".png",), None, _header, _read)
