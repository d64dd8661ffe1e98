"""Largest sizes of inputs, checked on headers before memory is taken."""

from __future__ import annotations

from pathlib import Path

from .errors import InputError

__all__ = [
    "MAX_CUBE_VALUES",
    "MAX_FRAME_PIXELS",
    "MAX_PACKED_BYTES",
    "MAX_TABLE_ROWS",
    "MAX_TEXTURE_PIXELS",
    "require_size",
]

#: Pixels of one photograph: the largest sensors on sale have 150 million.
MAX_FRAME_PIXELS = 2**28
#: Values of a spectral cube or picture, 1 GiB in single precision: 512 x 512 pixels at 1024 wavelengths.
MAX_CUBE_VALUES = 2**28
#: Unpacked bytes of a compressed file that is read from its start to its end, which takes some 3 s.
MAX_PACKED_BYTES = 2**30
#: Rows of a table: spectra from 300 to 1100 nm in steps of 0.01 nm have 80,000.
MAX_TABLE_ROWS = 2**18
#: Pixels of a texture, a lamp's pattern or a label picture, 1 GiB with three channels in double precision.
MAX_TEXTURE_PIXELS = 2**25


def require_size(path: Path, count: float, largest: int, what: str) -> None:
    """Require that an input is not larger than its limit.

    Parameters
    ----------
    path
        The file.
    count
        Size according to its header.
    largest
        The limit, a constant of this module.
    what
        Unit of the size, such as "pixels".

    Raises
    ------
    InputError
        If the size is above the limit.
    """
    if count > largest:
        raise InputError(path, f"{count:.0f} {what}", f"at most {largest} {what}", "Crop it, or split it.")
