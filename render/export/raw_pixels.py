"""Pictures that renderers wrote, each read with one clear message where it is missing or of another size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import NDArray

__all__ = ["exr_pixels", "npy_pixels", "raw_pixels"]

_EXPECTED = "a picture that the renderer wrote"
_HINT = "Run the renderer in its folder first."


def raw_pixels(path: Path, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Little-endian float32 of a shape. Raises InputError."""
    require_regular_file(path, _EXPECTED, _HINT)
    if path.stat().st_size != 4 * np.prod(shape):
        raise InputError(path, f"{path.stat().st_size} bytes", f"{4 * np.prod(shape)} bytes for {shape}", _HINT)
    return np.fromfile(path, "<f4").reshape(shape)


def npy_pixels(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An array of NumPy's format. Raises InputError."""
    require_regular_file(path, _EXPECTED, _HINT)
    try:
        found = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(path, str(error), "a NumPy array") from None
    if found.shape != shape:
        raise InputError(path, f"an array {found.shape}", f"an array {shape}")
    return np.asarray(found, np.float64)


def exr_pixels(path: Path, shape: tuple[int, int], channels: list[str]) -> NDArray[np.float64]:
    """(y, x, c) channels of an OpenEXR picture (y, x) by name. Raises InputError."""
    require_regular_file(path, _EXPECTED, _HINT)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the library raises exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", "an OpenEXR picture") from None
    missing = [name for name in channels if name not in planes]
    if missing:
        raise InputError(path, f"channels {', '.join(planes)}", f"channels {', '.join(channels)}")
    found = np.stack([planes[name] for name in channels], axis=-1).astype(np.float64)
    if found.shape[:2] != shape:
        raise InputError(path, f"{found.shape[1]} x {found.shape[0]} px", f"{shape[1]} x {shape[0]} px")
    return found
