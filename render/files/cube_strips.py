"""Spectral cubes larger than memory, rendered and written in strips of rows (NetCDF)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import xarray as xr
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import writing_hdf5

__all__ = ["strip_cameras", "write_strips"]

#: Rows of a strip, and of a chunk in the file.
ROWS = 64


def strip_cameras(camera: Camera, rows: int = ROWS) -> list[Camera]:
    """Cameras of strips of a picture, from the top.

    Parameters
    ----------
    camera
        Camera of the picture.
    rows
        Rows of a strip; the last may have fewer.

    Returns
    -------
    list of Camera
        One camera a strip.
    """
    u, v = camera.principal_point_px
    return [
        replace(
            camera,
            height_px=min(rows, camera.height_px - top),
            principal_point_px=np.array([u, v - top]),
        )
        for top in range(0, camera.height_px, rows)
    ]


def write_strips(path: Path, height: int, strips: Iterable[xr.Dataset]) -> None:
    """Write strips of a cube as one .nc file; one strip at a time is in memory.

    Parameters
    ----------
    path
        File to write; an incomplete one is removed.
    height
        Rows of all strips together.
    strips
        Cubes from the top down.

    Raises
    ------
    InputError
        If the strips have another number of rows in all, or the ending is another.
    """
    if path.suffix.lower() != ".nc":
        raise InputError(path, f"the ending '{path.suffix}'", ".nc, the only format written in strips")
    top = 0
    with writing_hdf5(path) as output, h5netcdf.File(output, "w") as file:
        for strip in strips:
            if top == 0:
                _prepare(file, strip, height)
            bottom = top + strip.sizes["y"]
            for name, variable in strip.data_vars.items():
                ordered = variable.transpose("y", "x", ...)
                file.variables[str(name)][top:bottom] = ordered.values
            top = bottom
        if top != height:
            raise InputError(path, f"strips of {top} rows", f"{height} rows")


def _prepare(file: h5netcdf.File, strip: xr.Dataset, height: int) -> None:
    """Create dimensions, attributes and empty variables after the first strip."""
    file.dimensions = {"y": height, "x": strip.sizes["x"], "wavelength": strip.sizes["wavelength"]}
    file.attrs.update(strip.attrs)
    wavelength = file.create_variable("wavelength", ("wavelength",), data=strip["wavelength"].values)
    wavelength.attrs.update(strip["wavelength"].attrs)
    for name, variable in strip.data_vars.items():
        ordered = variable.transpose("y", "x", ...)
        shape = (height, *ordered.shape[1:])
        stored = file.create_variable(
            str(name),
            ordered.dims,
            ordered.dtype,
            compression="gzip",
            compression_opts=4,
            chunks=(min(ROWS, height), *shape[1:]),
        )
        stored.attrs.update({key: _plain(value) for key, value in variable.attrs.items()})


def _plain(value: object) -> object:
    """A number as an array: h5netcdf stores it with its type."""
    return np.asarray(value) if isinstance(value, int | float) else value
