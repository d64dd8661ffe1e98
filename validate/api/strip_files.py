"""Files of the finished strips of a large cube, from which an interrupted render continues."""

from __future__ import annotations

from pathlib import Path

import xarray as xr
from cboxlab.rendering.files import read_cube, write_cube
from cboxlab.utils.files import load_checked, store_checked, temporary_file

__all__ = ["load_strip", "store_strip"]


def store_strip(path: Path, key: str, strip: xr.Dataset) -> None:
    """Store a strip in a file.

    Parameters
    ----------
    path
        The file; its folder is created if it is missing.
    key
        Text that identifies everything the strip was rendered from.
    strip
        Spectral cube of the strip.
    """
    path.parent.mkdir(exist_ok=True)
    with temporary_file(path, ".nc") as netcdf:
        write_cube(netcdf, strip)
        store_checked(path, key, netcdf.read_bytes())


def load_strip(path: Path, key: str) -> xr.Dataset | None:
    """Strip that was stored in a file.

    Parameters
    ----------
    path
        The file.
    key
        Key with which the strip was stored.

    Returns
    -------
    xarray.Dataset or None
        The strip; None if there is no file, if its key differs, or if it is damaged.
    """
    content = load_checked(path, key)
    if content is None:
        return None
    with temporary_file(path, ".nc") as netcdf:
        netcdf.write_bytes(content)
        return read_cube(netcdf)
