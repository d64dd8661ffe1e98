"""Radiance pictures: RGBE and XYZE, four bytes a pixel (G. Ward, "Real Pixels", 1991).

Rows are run-length encoded or flat.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.limits import MAX_CUBE_VALUES, MAX_PACKED_BYTES, require_size
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

from .colour_pictures import as_xyz_picture, primaries_matrix, space_matrix, stated_space, with_rounding
from .declared import Declared, photometric_factor, with_declarations

__all__ = ["is_radiance", "radiance_as_stored", "read_radiance"]

#: Hints on the unit of Radiance's programs in the two formats (179 lm/W; ra_xyze writes an exposure over 179).
_HINTS = {
    "rgbe": "Programs of Radiance write W m^-2 sr^-1 at 179 lm/W: declare scale=179; their primaries "
    "are declare colour-space=radiance.",
    "xyze": "Programs of Radiance write cd m^-2.",
}

#: Note on the steps of stored values.
_STEPS = (
    "eight bits a channel and one exponent for all three: a pixel's standard deviation is 0.29 steps, which is 0.11 to "
    "0.23 % of its largest channel and more of the others; values are taken in the middle of their steps, as Radiance "
    "does"
)

#: Pixels on each side among which values that vary too little share their error.
_AROUND_PX = 4

#: Steps within which such values lie.
_NEAR_STEPS = 4.0

#: Largest file header, bytes.
_MAX_HEADER_BYTES = 2**16

#: Largest side of a picture, px.
_MAX_SIDE_PX = 2**15


@dataclass(frozen=True)
class _Header:
    """Header of a picture."""

    #: rgbe or xyze.
    form: str
    #: Factor by which pixels were multiplied.
    exposure: float
    #: (3,) factors by which R, G, B were multiplied in addition.
    colour: tuple[float, ...]
    #: x, y of red, green, blue and white; None where not stated.
    primaries: tuple[float, ...] | None
    #: Direction of rows, such as -Y.
    rows: str
    #: Direction of columns, such as +X.
    columns: str
    #: Rows.
    height: int
    #: Columns.
    width: int
    #: Byte of the first row.
    offset: int


def is_radiance(path: Path) -> bool:
    """Whether the file begins as Radiance's pictures do.

    Parameters
    ----------
    path
        File of any kind.

    Returns
    -------
    bool
        True for '#?' at its beginning.
    """
    with path.open("rb") as file:
        return file.read(2) == b"#?"


def read_radiance(path: Path, declared: Declared) -> xr.Dataset:
    """Picture in X, Y, Z of a Radiance file, exposures divided out.

    Parameters
    ----------
    path
        The file.
    declared
        Units and scale; colour space where the header states no primaries.

    Returns
    -------
    xr.Dataset
        ``xyz`` (y, x, component), cd m^-2, with ``rounding``.

    Raises
    ------
    InputError
        If the file is damaged, or unit or colour space are missing.
    """
    header, values, step = _stored(path)
    matrix, used, space = np.eye(3), ["units", "scale"], "X, Y, Z"
    if header.form == "rgbe":
        if header.primaries is None:
            used.append("colour_space")
            matrix = space_matrix(path, declared, _HINTS[header.form])
        else:
            space, matrix = stated_space(header.primaries), primaries_matrix(header.primaries)
    factor = photometric_factor(path, None, declared, _HINTS[header.form])
    matrix = matrix * factor / (header.exposure * np.array(header.colour))
    return _with_steps(
        as_xyz_picture(values @ matrix.T), values, step, matrix, (declared, used, {"colour_space": space})
    )


def radiance_as_stored(path: Path) -> xr.Dataset | None:
    """R, G, B of a Radiance file in its numbers, exposures divided out.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    xr.Dataset or None
        ``rgb`` (y, x, component) with ``rounding``; None for a file of another kind, or with X, Y, Z.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    if path.suffix.lower() != ".hdr" or not path.is_file() or not is_radiance(path):
        return None
    header, values, step = _stored(path)
    if header.form != "rgbe":
        return None
    factor = 1 / (header.exposure * np.array(header.colour))
    picture = xr.Dataset({"rgb": (("y", "x", "component"), values * factor)}, coords={"component": list("RGB")})
    if header.primaries is not None:
        picture.attrs["colour_space"] = stated_space(header.primaries)
    return _with_steps(picture, values, step, np.diag(factor), (Declared(), [], {}))


def _stored(path: Path) -> tuple[_Header, NDArray[np.float64], NDArray[np.float64]]:
    """Header, values (y, x, 3) and their steps (y, x, 1) of a file."""
    try:
        require_size(path, path.stat().st_size, MAX_PACKED_BYTES, "bytes")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a Radiance picture") from None
    header = _header(path, content)
    return header, *_decoded(path, content, header)


def _with_steps(
    picture: xr.Dataset,
    values: NDArray[np.float64],
    step: NDArray[np.float64],
    matrix: NDArray[np.float64],
    declarations: tuple[Declared, list[str], dict[str, object]],
) -> xr.Dataset:
    """Picture with the errors of its steps, and notes on them and on what was declared."""
    sigma, shared, outside = _rounding(values, step, matrix)
    notes = [_STEPS]
    if outside:
        notes.append(
            f"pixels with a channel at 0: {outside}; colours outside the primaries are cut off there, and what may be "
            "lacking is in the uncertainty"
        )
    declared, used, of_file = declarations
    return with_declarations(with_rounding(picture, sigma, shared), declared, used, notes, of_file)


def _header(path: Path, content: bytes) -> _Header:
    """Header of a file's content. Raises InputError for a missing or unknown entry."""
    expected = "a Radiance picture with FORMAT=32-bit_rle_rgbe or 32-bit_rle_xyze"
    end = content.find(b"\n\n", 0, _MAX_HEADER_BYTES)
    line_end = content.find(b"\n", end + 2, end + 80)
    if end < 0 or line_end < 0:
        raise InputError(path, "no header with an empty line after it", expected)
    lines = content[:end].decode("latin-1").splitlines()
    size = re.fullmatch(
        r"([+-][XY])\s+(\d{1,6})\s+([+-][XY])\s+(\d{1,6})",
        content[end + 2 : line_end].decode("latin-1").strip(),
    )
    if size is None or {size[1][1], size[3][1]} != {"X", "Y"}:
        raise InputError(path, "no size after the header", "a line such as '-Y 480 +X 640'")
    entries = [line.partition("=")[::2] for line in lines if "=" in line]
    form = [value.strip() for key, value in entries if key.strip() == "FORMAT"]
    match = re.fullmatch(r"32-bit_rle_(rgbe|xyze)", form[-1] if form else "")
    if match is None:
        raise InputError(f"{path}: FORMAT", f"'{form[-1]}'" if form else "nothing", expected)
    exposure, colour, primaries = 1.0, np.ones(3), None
    for key, value in ((k.strip(), v) for k, v in entries):
        if key == "EXPOSURE":
            exposure *= _numbers(path, key, value, 1)[0]
        elif key == "COLORCORR":
            colour = colour * _numbers(path, key, value, 3)
        elif key == "PRIMARIES":
            primaries = tuple(_numbers(path, key, value, 8))
    height, width = int(size[2]), int(size[4])
    if not (0 < height <= _MAX_SIDE_PX and 0 < width <= _MAX_SIDE_PX):
        raise InputError(path, f"{height} x {width} px", f"1 to {_MAX_SIDE_PX} px a side")
    require_size(path, 3 * height * width, MAX_CUBE_VALUES, "values")
    return _Header(match[1], exposure, tuple(colour), primaries, size[1], size[3], height, width, line_end + 1)


def _numbers(path: Path, key: str, text: str, count: int) -> NDArray[np.float64]:
    """Numbers of an entry. Raises InputError for another count, and unless they are above 0."""
    values = np.array([number_of(part) for part in text.split()])
    if values.size != count or not np.isfinite(values).all() or (key != "PRIMARIES" and (values <= 0).any()):
        raise InputError(f"{path}: {key}", repr(text.strip()), f"{count} numbers above 0")
    return values


def _rounding(
    values: NDArray[np.float64], step: NDArray[np.float64], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Standard deviations (y, x, 3) of X, Y, Z, their shared part, and pixels cut at 0.

    values : (y, x, 3) of the channels. step : (y, x, 1) between their values. matrix : to X, Y, Z.

    Within a step any value is equally likely: step / sqrt(12). Where the values around differ by a step or more such
    errors are independent (Widrow and Kollar, Quantization Noise, 2008); where they are all equal, so are the errors.
    Between, the part shared is linear in the difference, about as even surfaces with noise show (a test counts). A
    channel at 0 may have been cut off there: it is anything down to where X, Y or Z is 0.
    """
    each = np.broadcast_to((step / np.sqrt(12)) ** 2, values.shape)
    same = np.clip(1 - _spread(values, step), 0, 1) ** 2 * each
    lost = np.zeros(values.shape)
    cut = (values < step) & (step > 0)
    for channel in range(3):
        column = matrix[:, channel]
        others = np.where(np.arange(3) == channel, 0.0, values) @ matrix[column > 0].T
        room = np.maximum(others / column[column > 0], 0.0).min(axis=-1)
        lost[..., channel] = np.where(cut[..., channel], room**2 / 3, 0.0)
    sigma, shared = (np.sqrt((part + lost) @ (matrix**2).T) for part in (each, same))
    return sigma, shared, int((lost > 0).any(axis=-1).sum())


def _spread(values: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x, 3) rms difference from the pixels around that are up to 4 steps away, in steps."""
    squares, count, reach = np.zeros(values.shape), np.ones(values.shape), _AROUND_PX
    size = np.where(step > 0, step, 1.0)
    around = np.pad(values, ((reach, reach), (reach, reach), (0, 0)), constant_values=np.inf)
    height, width = values.shape[:2]
    for down, right in np.ndindex(2 * reach + 1, 2 * reach + 1):
        apart = np.abs(around[down : down + height, right : right + width] - values) / size
        near = apart <= _NEAR_STEPS
        squares += np.where(near, apart, 0.0) ** 2
        count += near
    return np.asarray(np.sqrt(squares / count))


def _decoded(path: Path, content: bytes, header: _Header) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values as stored (y, x, 3), and the steps between them (y, x, 1), top row first.

    The first row is on top, the first column at the left. A value is in the middle of its step: Radiance cuts off where
    it writes, and adds half a step where it reads.
    """
    data, position = np.frombuffer(content, np.uint8), header.offset
    pixels = np.empty((header.height, header.width, 4), np.uint8)
    for row in pixels:
        position = _scanline(path, data, position, row)
    if header.rows[1] == "X":
        pixels = pixels.swapaxes(0, 1)
    signs = {header.rows[1]: header.rows[0], header.columns[1]: header.columns[0]}
    pixels = pixels[:: 1 if signs["Y"] == "-" else -1, :: 1 if signs["X"] == "+" else -1]
    exponent = pixels[..., 3:].astype(int)
    step = np.where(exponent > 0, np.ldexp(1.0, exponent - 136), 0.0).astype(np.float64)
    return (pixels[..., :3] + 0.5) * step, step


def _scanline(path: Path, data: NDArray[np.uint8], position: int, row: NDArray[np.uint8]) -> int:
    """Fill one row (width, 4); returns where the next one begins."""
    width = len(row)
    start = data[position : position + 4]
    if not (8 <= width <= 0x7FFF and start.size == 4 and start[0] == start[1] == 2 and start[2] < 128):
        return _flat(path, data, position, row)
    if int(start[2]) << 8 | int(start[3]) != width:
        raise InputError(path, "a row of another width", f"{width} px, as its header says")
    position += 4
    for channel in range(4):
        filled = 0
        while filled < width:
            if position + 2 > data.size:
                raise InputError(path, f"{data.size} bytes", "a complete picture")
            count = int(data[position])
            run = count > 128
            count -= 128 * run
            values = data[position + 1 : position + 2] if run else data[position + 1 : position + 1 + count]
            if count == 0 or filled + count > width or values.size < (1 if run else count):
                raise InputError(path, f"a row that does not fit at byte {position}", "a complete picture")
            row[filled : filled + count, channel] = values
            filled += count
            position += 1 + values.size
    return position


def _flat(path: Path, data: NDArray[np.uint8], position: int, row: NDArray[np.uint8]) -> int:
    """Pixels one by one; 1, 1, 1, n repeats the one before."""
    filled, shift = 0, 0
    while filled < len(row):
        pixel = data[position : position + 4]
        position += 4
        if pixel.size < 4:
            raise InputError(path, f"{data.size} bytes", "a complete picture")
        if pixel[0] == pixel[1] == pixel[2] == 1:
            count = int(pixel[3]) << shift
            if filled == 0 or filled + count > len(row) or shift > 16:
                raise InputError(path, f"a row that does not fit at byte {position - 4}", "a complete picture")
            row[filled : filled + count] = row[filled - 1]
            filled, shift = filled + count, shift + 8
        else:
            row[filled] = pixel
            filled, shift = filled + 1, 0
    return position
