"""Portable float maps (PFM): 32-bit floats of one plane or of R, G, B, the bottom row first."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from cboxlab.utils.limits import MAX_CUBE_VALUES, require_size
from numpy.typing import NDArray

__all__ = ["PFM_ENDING", "read_pfm"]

#: Ending of these files.
PFM_ENDING = ".pfm"
#: Header: kind, columns, rows, and a scale whose sign gives the order of bytes; one white space ends it.
_HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,6})\s+(\d{1,6})\s+([+-]?\d*\.?\d*(?:[eE][+-]?\d+)?)\s")
#: Longest header, bytes.
_MAX_HEADER_BYTES = 100


def read_pfm(path: Path) -> NDArray[np.float32]:
    """Planes of a PFM.

    The size of the scale in the header is not applied: it has no agreed meaning, and most programs write 1.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    NDArray
        (plane, y, x), the top row first; three planes of R, G, B, or a single one.

    Raises
    ------
    InputError
        If the file cannot be read, its header is another, or its length does not fit to the header.
    """
    require_regular_file(path, "a PFM picture")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a PFM picture") from None
    header = _HEADER.match(content[:_MAX_HEADER_BYTES])
    if header is None:
        raise InputError(path, "no header of a PFM", "lines such as 'PF', '640 480', '-1.0'")
    planes, columns, rows = 3 if header[1] == b"PF" else 1, int(header[2]), int(header[3])
    require_size(path, planes * columns * rows, MAX_CUBE_VALUES, "values")
    size = 4 * planes * columns * rows
    if size == 0 or len(content) != header.end() + size:
        fault = f"{len(content) - header.end()} bytes after the header"
        raise InputError(path, fault, f"{size} for {columns} x {rows} px of {planes} floats")
    order = "<f4" if header[4].startswith(b"-") else ">f4"
    values = np.frombuffer(content, order, offset=header.end()).reshape(rows, columns, planes)
    return np.ascontiguousarray(np.moveaxis(values[::-1], -1, 0), np.float32)
