"""Place of a file's pixels in a larger picture: OpenEXR's data window, ENVI's first pixel.

In OpenEXR the picture is the display window. A file stores the pixels of its data window, which may be a part of the
picture or reach beyond it ("Technical Introduction to OpenEXR"). Pixels of two files are the same where their
coordinates are the same. The dataset of a picture that is not all of its display window has the attribute ``window``,
text in JSON. A picture without it begins at pixel (0, 0) and is complete.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = [
    "Window",
    "common_pixels",
    "exr_window",
    "inside_display",
    "window_in_file",
    "window_of",
    "window_of_header",
    "with_window",
]

#: Attribute of a dataset that is part of a larger picture.
_ATTRIBUTE = "window"


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels, and the picture it belongs to."""

    #: Column of its first pixel in the picture's coordinates, px.
    left: int
    #: Row of its first pixel in the picture's coordinates, px.
    top: int
    #: Columns, px.
    width: int
    #: Rows, px.
    height: int
    #: The picture's left, top, width and height, px; None where the file does not state its size.
    display: tuple[int, int, int, int] | None = None

    @property
    def is_complete(self) -> bool:
        """Whether it is the picture, and begins at pixel (0, 0)."""
        rectangle = (self.left, self.top, self.width, self.height)
        return rectangle[:2] == (0, 0) and self.display in (None, rectangle)

    def __str__(self) -> str:
        columns, rows = (
            f"x {self.left} to {self.left + self.width - 1}",
            f"y {self.top} to {self.top + self.height - 1}",
        )
        return f"{columns}, {rows}"

    def overlap(self, other: tuple[int, int, int, int]) -> Window | None:
        """Pixels in common with another rectangle.

        Parameters
        ----------
        other
            Left, top, width and height, px.

        Returns
        -------
        Window or None
            The pixels, with the same picture; None where there are none.
        """
        left, top = max(self.left, other[0]), max(self.top, other[1])
        right = min(self.left + self.width, other[0] + other[2])
        bottom = min(self.top + self.height, other[1] + other[3])
        return Window(left, top, right - left, bottom - top, self.display) if right > left and bottom > top else None

    def slices(self, part: Window) -> tuple[slice, slice]:
        """Rows and columns of a part, counted from this window's first pixel.

        Parameters
        ----------
        part
            A window inside this one.

        Returns
        -------
        tuple of slice
            Rows and columns.
        """
        top, left = part.top - self.top, part.left - self.left
        return slice(top, top + part.height), slice(left, left + part.width)


def with_window(picture: xr.Dataset, window: Window | None) -> xr.Dataset:
    """Picture with its place in a larger one.

    Parameters
    ----------
    picture
        Dataset over y and x.
    window
        Its pixels; None and a complete window are not noted.

    Returns
    -------
    xr.Dataset
        The same arrays.
    """
    if window is None or window.is_complete:
        return picture
    return picture.assign_attrs({_ATTRIBUTE: json.dumps(asdict(window))})


def window_of(picture: xr.Dataset) -> Window | None:
    """Place of a picture in a larger one.

    Parameters
    ----------
    picture
        Dataset over y and x.

    Returns
    -------
    Window or None
        None for a complete picture, and where the attribute does not fit the picture's size.
    """
    try:
        record = json.loads(picture.attrs[_ATTRIBUTE])
        left, top, width, height = (int(record[name]) for name in ("left", "top", "width", "height"))
        display = record.get("display")
        if display is not None:
            x, y, columns, rows = map(int, display)
            display = x, y, columns, rows
        window = Window(left, top, width, height, display)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    return window if (window.height, window.width) == (picture.sizes.get("y"), picture.sizes.get("x")) else None


def window_of_header(header: Mapping[str, Any]) -> Window:
    """Data window of an OpenEXR header, in its display window.

    Parameters
    ----------
    header
        As the OpenEXR library gives it.

    Returns
    -------
    Window
        The pixels that are stored.
    """
    data, display = (_rectangle(header[name]) for name in ("dataWindow", "displayWindow"))
    return Window(*data, display)


def exr_window(window: Window) -> dict[str, Any]:
    """Entries of an OpenEXR header that place a picture.

    Parameters
    ----------
    window
        The pixels that are stored.

    Returns
    -------
    dict
        ``dataWindow`` and ``displayWindow``; the latter reaches to the last pixel where the picture's size is not
        known.
    """
    data = (window.left, window.top, window.width, window.height)
    display = window.display or (0, 0, window.left + window.width, window.top + window.height)
    return {"dataWindow": _corners(data), "displayWindow": _corners(display)}


def window_in_file(path: Path) -> Window | None:
    """Data window of an OpenEXR file.

    Parameters
    ----------
    path
        File of any kind.

    Returns
    -------
    Window or None
        None for a complete picture, and for a file that is no OpenEXR file.
    """
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            window = window_of_header(file.header())
    except (OSError, RuntimeError, ValueError, TypeError, KeyError):
        return None
    return None if window.is_complete else window


def inside_display(path: Path, window: Window) -> Window:
    """Part of a data window that lies in its display window.

    Parameters
    ----------
    path
        File, for the message.
    window
        Data window with its display window.

    Returns
    -------
    Window
        The part; renders with overscan store more than the picture.

    Raises
    ------
    InputError
        If no pixel lies in the picture.
    """
    part = window if window.display is None else window.overlap(window.display)
    if part is None:
        expected = f"pixels of its display window, {_display(window)}"
        raise InputError(f"{path}: data window", str(window), expected)
    return part


def common_pixels(first: Window, second: Window, names: tuple[str, str]) -> Window | None:
    """Pixels that two files of one picture both have.

    Parameters
    ----------
    first, second
        Windows of the two; a window without a stated picture belongs to any.
    names
        Names of the two files in messages.

    Returns
    -------
    Window or None
        None where both are complete or hold the same pixels, so that nothing has to be cut.

    Raises
    ------
    InputError
        If the two belong to pictures of different sizes, or have no pixel in common.
    """
    if first.is_complete and second.is_complete:
        return None
    if None not in (first.display, second.display) and first.display != second.display:
        raise InputError(f"{names[1]}: display window", _display(second), f"{_display(first)}, as in {names[0]}")
    part = first.overlap((second.left, second.top, second.width, second.height))
    if part is None:
        raise InputError(names[1], f"the pixels {second}", f"some of {first}, the pixels of {names[0]}")
    same = (part.width, part.height) == (first.width, first.height) == (second.width, second.height)
    return None if same else part


def _display(window: Window) -> str:
    """The picture of a window, in words."""
    return "none" if window.display is None else str(Window(*window.display))


def _rectangle(corners: Any) -> tuple[int, int, int, int]:
    """Left, top, width and height of OpenEXR's first and last pixel."""
    low, high = (np.asarray(corner, np.int64) for corner in corners)
    return int(low[0]), int(low[1]), int(high[0] - low[0] + 1), int(high[1] - low[1] + 1)


def _corners(rectangle: tuple[int, int, int, int]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """OpenEXR's first and last pixel of left, top, width and height."""
    left, top, width, height = rectangle
    return np.array([left, top], np.int32), np.array([left + width - 1, top + height - 1], np.int32)
