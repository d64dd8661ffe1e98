"""Channels and header of an OpenEXR file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

__all__ = ["ExrChannels", "read_channels", "write_channels"]

#: Bytes of pixels that one byte of an OpenEXR file can hold: its compressions use deflate or pack less.
_DENSEST = 1100


@dataclass(frozen=True, eq=False)
class ExrChannels(OwnMappings):
    """planes : (y, x) float32 by name. header : as OpenEXR gives it."""

    planes: dict[str, NDArray[np.float32]]
    header: dict[str, Any]


def read_channels(path: Path) -> ExrChannels:
    """All channels. Raises InputError for a file that cannot be read, several parts, or channels of several sizes."""
    try:
        _require_size(path)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # The file empties its header and channels when it is closed.
            header = dict(file.header())
            planes = {name: np.array(c.pixels, np.float32) for name, c in file.channels().items()}
            parts = len(file.parts)
    except (OSError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"a file that cannot be read ({error})", "an OpenEXR file") from None
    if parts > 1:
        raise InputError(path, f"{parts} parts", "one part", "Store the radiance as a file of its own.")
    if len({plane.shape for plane in planes.values()}) > 1:
        raise InputError(path, "channels of several sizes", "channels of one size")
    return ExrChannels(planes, header)


def _require_size(path: Path) -> None:
    """Raises InputError where the header states more pixels than the file can hold."""
    with OpenEXR.File(str(path), header_only=True) as file:
        low, high = (np.asarray(corner, float) for corner in file.header()["dataWindow"])
    pixels = float(np.prod(high - low + 1))
    if pixels * 2 > max(_DENSEST * path.stat().st_size, 2**26):
        raise InputError(path, f"{path.stat().st_size} bytes for {pixels:.0f} pixels", "a complete picture")


def write_channels(path: Path, header: Mapping[str, Any], planes: Mapping[str, NDArray[np.float32]]) -> None:
    """Write scanlines of 32-bit floats, deflated. Raises InputError where the disk does not take all of it."""
    kind = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    try:
        with replacing(path) as temporary, OpenEXR.File(kind | dict(header), dict(planes)) as file:
            file.write(str(temporary))
    except RuntimeError as error:  # the library's error for a full disk, which names the temporary file
        raise InputError(path, str(error).rpartition('". ')[2], "a file that can be written") from None
