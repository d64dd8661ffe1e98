"""OpenEXR files of counts: one channel is a frame, several channels or parts are bands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import FrameHeader, FrameReader, as_counts, require_plausible_size

#: First and last (column, row) of a window of pixels.
_Window = tuple[tuple[int, int], tuple[int, int]]


def _window(header: dict[str, Any], name: str) -> _Window:
    (left, top), (right, bottom) = header[name]
    return (int(left), int(top)), (int(right), int(bottom))


def _size(window: _Window) -> tuple[int, int]:
    """(height, width) of a window, px."""
    (left, top), (right, bottom) = window
    return bottom - top + 1, right - left + 1


def _names(headers: list[dict[str, Any]]) -> list[str]:
    """Names of all channels: those of the parts where each has one channel, else both."""
    channels = [[channel.name for channel in header["channels"]] for header in headers]
    if len(headers) == 1:
        return channels[0]
    parts = [str(header.get("name", index)) for index, header in enumerate(headers)]
    if all(len(names) == 1 for names in channels):
        return parts
    return [f"{part}.{name}" for part, names in zip(parts, channels, strict=True) for name in names]


def _require_whole_pictures(path: Path, headers: list[dict[str, Any]]) -> None:
    """Refuse parts that lack pixels of their picture, and pictures of different size."""
    displays = {_window(header, "displayWindow") for header in headers}
    if len(displays) > 1:
        sizes = ", ".join(f"{width} x {height}" for height, width in map(_size, sorted(displays)))
        raise InputError(path, f"parts of different windows ({sizes})", "pictures of one window")
    for header in headers:
        data, display = _window(header, "dataWindow"), _window(header, "displayWindow")
        outside = [data[0][k] > display[0][k] or data[1][k] < display[1][k] for k in (0, 1)]
        if any(outside):
            raise InputError(
                path,
                f"pixels from {data[0]} to {data[1]} of a picture from {display[0]} to {display[1]}",
                "all pixels of the picture",
                "Save it without cropping to its data window.",
            )
        if any(channel.xSampling != 1 or channel.ySampling != 1 for channel in header["channels"]):
            raise InputError(path, "a channel of fewer rows or columns than the picture", "channels of one size")


def _headers(path: Path, file: Any) -> list[dict[str, Any]]:
    """Headers of all parts with channels, checked."""
    headers = [part.header for part in file.parts if part.header.get("channels")]
    if not headers:
        raise InputError(path, "no channels", "one channel per band")
    if deep := [header for header in headers if "deep" in str(header.get("type", "")).lower()]:
        raise InputError(path, f"deep data ({deep[0]['type']})", "one value in each pixel")
    _require_whole_pictures(path, headers)
    return headers


def _header(path: Path) -> FrameHeader:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
        headers = _headers(path, file)
        names = tuple(_names(headers))
        shape = _size(_window(headers[0], "displayWindow"))
        largest = max(int(np.prod(_size(_window(header, "dataWindow")))) for header in headers)
    require_plausible_size(path, (len(names), 1, max(largest, int(np.prod(shape)))))
    return FrameHeader(shape, len(names), bands=names if len(names) > 1 else ())


def _planes(path: Path, pictures: range) -> list[NDArray]:
    """(y, x) pixels of channels within the picture, in their own type."""
    import OpenEXR

    planes = []
    with OpenEXR.File(str(path), separate_channels=True) as file:
        _headers(path, file)
        for part in file.parts:
            (left, top), display = part.header["dataWindow"][0], _window(part.header, "displayWindow")
            rows, columns = _size(display)
            first_row, first_column = display[0][1] - int(top), display[0][0] - int(left)
            for channel in part.channels.values():
                pixels = np.asarray(channel.pixels)
                planes.append(pixels[first_row : first_row + rows, first_column : first_column + columns])
    return [planes[k] for k in pictures]


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    return np.concatenate([as_counts(path, plane[None]) for plane in _planes(path, pictures)])


def _values(path: Path, pictures: range) -> NDArray[np.float64]:
    return np.stack([np.asarray(plane, np.float64) for plane in _planes(path, pictures)])


READER = FrameReader("exr", "OpenEXR", (".exr",), None, _header, _read, values=_values)
