"""Readers of the files that renderers write; a missing or wrong file gives one message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import NDArray

from .exported import Layout, channel_groups

__all__ = ["exr_pixels", "exr_radiance", "npy_pixels", "raw_pixels"]

_EXPECTED = "a picture that the renderer wrote"
_HINT = "Run the renderer in its folder first."


def raw_pixels(path: Path, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Numbers of a file of little-endian float32 without header.

    Parameters
    ----------
    path
        The file.
    shape
        Expected shape, last index fastest.

    Returns
    -------
    NDArray
        The numbers, of shape ``shape``.

    Raises
    ------
    InputError
        If the file is missing or has another number of bytes.
    """
    require_regular_file(path, _EXPECTED, _HINT)
    if path.stat().st_size != 4 * np.prod(shape):
        raise InputError(path, f"{path.stat().st_size} bytes", f"{4 * np.prod(shape)} bytes for {shape}", _HINT)
    return np.fromfile(path, "<f4").reshape(shape)


def npy_pixels(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Numbers of a file in NumPy's format.

    Parameters
    ----------
    path
        The file.
    shape
        Expected shape.

    Returns
    -------
    NDArray
        The numbers, of shape ``shape``.

    Raises
    ------
    InputError
        If the file is missing, is no NumPy array, or has another shape.
    """
    require_regular_file(path, _EXPECTED, _HINT)
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)  # a header may state more than the file holds
    except Exception as error:  # the reader raises exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", "a NumPy array") from None
    if not isinstance(array, np.ndarray):
        raise InputError(path, "an archive of arrays", "a NumPy array")
    if array.shape != shape:
        raise InputError(path, f"an array {array.shape}", f"an array {shape}")
    try:
        return np.array(array, np.float64)
    except (TypeError, ValueError):
        raise InputError(path, f"values of the type {array.dtype}", "numbers") from None


def exr_pixels(path: Path, shape: tuple[int, int], channels: list[str]) -> NDArray[np.float64]:
    """Channels of an OpenEXR file by name.

    Parameters
    ----------
    path
        The file.
    shape
        Expected rows and columns.
    channels
        Names of c channels, in the order wanted.

    Returns
    -------
    NDArray
        (y, x, c) values as stored.

    Raises
    ------
    InputError
        If the file is missing or damaged, lacks a channel, or has another size.
    """
    require_regular_file(path, _EXPECTED, _HINT)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the library raises exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", "an OpenEXR picture") from None
    missing = [name for name in channels if name not in planes]
    if missing:
        raise InputError(path, f"channels {', '.join(planes)}", f"channels {', '.join(channels)}")
    pixels = np.stack([planes[name] for name in channels], axis=-1).astype(np.float64)
    if pixels.shape[:2] != shape:
        raise InputError(path, f"{pixels.shape[1]} x {pixels.shape[0]} px", f"{shape[1]} x {shape[0]} px")
    return pixels


def exr_radiance(folder: Path, layout: Layout, extra_rows: int = 0) -> NDArray[np.float32]:
    """Radiance of a renderer that writes one R, G, B file for a batch and three wavelengths.

    Parameters
    ----------
    folder
        Folder of the renderer; its files are ``out/batch-B-group-G.exr``.
    layout
        Layout of the export.
    extra_rows
        Rows above the film, which are left out.

    Returns
    -------
    NDArray
        (batch, film y, film x, w) radiance, W m^-2 sr^-1 nm^-1.

    Raises
    ------
    InputError
        For a missing or faulty file.
    """
    shape = layout.film_height_px + extra_rows, layout.film_width_px
    radiance = np.empty((layout.settings.batches, layout.film_height_px, shape[1], layout.channels), np.float32)
    for number, group in enumerate(channel_groups(layout.channels, len("RGB"))):
        for batch, rendering in enumerate(radiance):
            path = folder / "out" / f"batch-{batch}-group-{number}.exr"
            rendering[..., group] = exr_pixels(path, shape, list("RGB"))[extra_rows:, :, : len(group)]
    return radiance
