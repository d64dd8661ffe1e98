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
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.limits import MAX_CUBE_VALUES, require_size
from numpy.typing import NDArray

from .headers import Window, inside_display, listed, one_layer_hint, window_of_header

__all__ = ["ExrChannels", "read_channels", "read_layers", "require_exr_size", "write_channels"]

#: Bytes of pixels that one byte of an OpenEXR file can hold: its compressions use deflate or pack less.
_MAX_COMPRESSION = 1100


@dataclass(frozen=True, eq=False)
class ExrChannels(FrozenMappings):
    """The channels of a file, over its data window as far as it lies in the display window."""

    #: (y, x) float32 by name.
    planes: dict[str, NDArray[np.float32]]
    #: Header as the OpenEXR library gives it.
    header: dict[str, Any]
    #: The pixels of ``planes`` in the display window; None for channels that were not read from a file.
    window: Window | None = None
    #: What a reader has to know, one note each.
    notes: tuple[str, ...] = ()


def read_channels(path: Path) -> ExrChannels:
    """All channels of a file of one part.

    Parameters
    ----------
    path
        OpenEXR file.

    Returns
    -------
    ExrChannels
        Channels as float32. Pixels outside the display window are left out with a note, those of a data window
        smaller than the display window are noted.

    Raises
    ------
    InputError
        If the file cannot be read, has several parts, channels of several sizes, or no pixel in its display window.
    """
    channels, parts = _read(path)
    if len(parts) > 1:
        description = f"{len(parts)} parts ({listed([name or 'without a name' for name in parts])})"
        software = str(channels.header.get("software", ""))
        raise InputError(path, description, "one part", one_layer_hint("", software))
    return channels


def read_layers(path: Path) -> ExrChannels:
    """All channels of a file of one or several parts.

    Parameters
    ----------
    path
        OpenEXR file.

    Returns
    -------
    ExrChannels
        As ``read_channels``. Channels of several parts bear the name of their part as layer. Parts with another data
        window than the first are left out with a note.

    Raises
    ------
    InputError
        As ``read_channels``, except for several parts.
    """
    return _read(path)[0]


def _read(path: Path) -> tuple[ExrChannels, list[str]]:
    """Channels of all parts of the first one's data window, and the names of all parts."""
    notes: list[str] = []
    try:
        require_exr_size(path)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # The file empties its header and channels when it is closed.
            header = dict(file.header())
            parts = [str(part.header.get("name", "")) for part in file.parts]
            planes: dict[str, NDArray[np.float32]] = {}
            for number, part_name in enumerate(parts):
                if not _same_window(file.header(number), header):
                    notes.append(f"the part '{part_name}' has another data window and is left out")
                    continue
                for name, channel in file.channels(number).items():
                    key = name if number == 0 or part_name in name else f"{part_name}.{name}"
                    planes[key] = np.array(channel.pixels, np.float32)
    except (OSError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"a file that cannot be read ({error})", "an OpenEXR file") from None
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) > 1:
        raise InputError(path, "channels of several sizes", "channels of one size")
    window = window_of_header(header)
    part = inside_display(path, window)
    if shapes == {(window.height, window.width)} and part != window:
        rows, columns = window.slices(part)
        planes = {name: np.ascontiguousarray(plane[rows, columns]) for name, plane in planes.items()}
        notes.append(f"pixels outside the display window (overscan) are left out: {part} of {window} are read")
    if (part.left, part.top, part.width, part.height) != part.display:
        notes.append(f"the data window is part of the display window: {part}")
    return ExrChannels(planes, header, part, tuple(notes)), parts


def _same_window(header: Mapping[str, Any], first: Mapping[str, Any]) -> bool:
    """Whether two parts hold the same pixels."""
    return bool(np.array_equal(np.asarray(header["dataWindow"]), np.asarray(first["dataWindow"])))


def require_exr_size(path: Path) -> None:
    """Require that a header states no more pixels than the limit, and than the file can hold.

    Parameters
    ----------
    path
        OpenEXR file.

    Raises
    ------
    InputError
        If it states more pixels.
    """
    with OpenEXR.File(str(path), header_only=True) as file:
        low, high = (np.asarray(corner, float) for corner in file.header()["dataWindow"])
        channels = len(file.header()["channels"])
    pixels = float(np.prod(high - low + 1))
    require_size(path, pixels * channels, MAX_CUBE_VALUES, "values")
    if pixels * 2 > max(_MAX_COMPRESSION * path.stat().st_size, 2**26):
        raise InputError(path, f"{path.stat().st_size} bytes for {pixels:.0f} pixels", "a complete picture")


def write_channels(path: Path, header: Mapping[str, Any], planes: Mapping[str, NDArray[np.float32]]) -> None:
    """Write scanlines of 32-bit floats, deflated.

    Parameters
    ----------
    path
        File to write; an incomplete one is removed.
    header
        Further entries of the header.
    planes
        (y, x) float32 by name of the channel.

    Raises
    ------
    InputError
        If the disk does not take all of it.
    """
    kind = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    try:
        with replacing(path) as temporary, OpenEXR.File(kind | dict(header), dict(planes)) as file:
            file.write(str(temporary))
    except RuntimeError as error:  # the library's error for a full disk, which names the temporary file
        raise InputError(path, str(error).rpartition('". ')[2], "a file that can be written") from None
