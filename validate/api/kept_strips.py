"""Finished strips of a large cube, kept until all of it is written, so that an interrupted render goes on."""

from __future__ import annotations

from pathlib import Path

import xarray as xr
from cboxlab.rendering.files import read_cube, write_cube
from cboxlab.utils.files import load_checked, store_checked, temporary_file

__all__ = ["keep_strip", "kept_strip"]


def keep_strip(place: Path, key: str, cube: xr.Dataset) -> None:
    """Keep a strip in a file, whose folder is made. key : what it was made from."""
    place.parent.mkdir(exist_ok=True)
    with temporary_file(place, ".nc") as written:
        write_cube(written, cube)
        store_checked(place, key, written.read_bytes())


def kept_strip(place: Path, key: str) -> xr.Dataset | None:
    """The strip that was kept with the same key; None if there is none, or a damaged one."""
    stored = load_checked(place, key)
    if stored is None:
        return None
    with temporary_file(place, ".nc") as written:
        written.write_bytes(stored)
        return read_cube(written)
