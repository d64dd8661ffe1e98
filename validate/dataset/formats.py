"""Files of a picture: NetCDF or Zarr, and copies of its radiance in other formats."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import xarray as xr
from cboxlab.rendering.files import open_netcdf, write_cube
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing, writing_hdf5
from isal import isal_zlib
from numpy.typing import NDArray

__all__ = [
    "COPY_ENDINGS",
    "MEDIA_TYPES",
    "PICTURE_ENDINGS",
    "open_picture",
    "require_format",
    "write_copy",
    "write_picture",
]

#: Ending of a picture's file by the name of its format in a recipe.
PICTURE_ENDINGS = {"netcdf": ".nc", "zarr": ".zarr.zip"}

#: Media type of a picture's file by the name of its format.
MEDIA_TYPES = {"netcdf": "application/x-netcdf", "zarr": "application/zip"}

#: Ending of a copy of the radiance by the name of its format in a recipe.
COPY_ENDINGS = {"exr": ".exr", "envi": ".hdr", "hdf5": ".mat", "png": ".png"}

#: Level of deflate by ISA-L: it takes a sixth of the time of zlib, for 3 % more disk.
_DEFLATE = 1

#: Level of Zstandard in Blosc: it takes a seventh of the time of deflate, for 3 % more disk.
_ZSTANDARD = 3

#: Date of the members of a Zarr file, the earliest of the format: files must not depend on the clock.
_DATE = (1980, 1, 1, 0, 0, 0)


def require_format(name: str, where: str) -> None:
    """Raise InputError for a format whose package is not installed.

    Parameters
    ----------
    name
        "netcdf" or "zarr".
    where
        File and key for the error.

    Raises
    ------
    InputError
        If the package zarr is missing.
    """
    if name == "zarr":
        try:
            import zarr  # noqa: F401
        except ImportError:
            hint = "pip install 'cboxlab[zarr]'"
            raise InputError(where, "'zarr' without the package zarr", "'netcdf', or that package", hint) from None


def write_picture(path: Path, cube: xr.Dataset) -> None:
    """Write a picture, each array in one chunk; parts of light have a chunk each.

    Parameters
    ----------
    path
        File to write, completely or not at all, with an ending of PICTURE_ENDINGS.
    cube
        The picture.
    """
    if path.name.endswith(PICTURE_ENDINGS["zarr"]):
        _write_zarr(path, cube)
        return
    with writing_hdf5(path) as raw:
        _write_structure(raw, cube)
        with h5py.File(raw, "r+") as file:
            for name, values in cube.data_vars.items():
                step = _chunk(values)[0]
                for first in range(0, len(values), step):
                    offset = (first, *(0 for _ in values.shape[1:]))
                    file[str(name)].id.write_direct_chunk(offset, _deflated(values.values[first : first + step]))


def _write_structure(raw: io.RawIOBase, cube: xr.Dataset) -> None:
    """Write everything of a picture but the values of its variables, whose chunks remain absent."""
    with h5netcdf.File(raw, "w") as file:
        file.dimensions = {str(name): size for name, size in cube.sizes.items()}
        file.attrs.update(cube.attrs)
        packed: dict[str, Any] = {"compression": "gzip", "compression_opts": _DEFLATE, "shuffle": True}
        for name, values in cube.variables.items():
            if name in cube.data_vars:
                fill = np.nan if values.dtype.kind == "f" else None
                options = {**packed, "chunks": _chunk(values), "fillvalue": fill}
                variable = file.create_variable(str(name), values.dims, values.dtype, **options)
            else:
                variable = file.create_variable(str(name), values.dims, data=values.values)
            variable.attrs.update(values.attrs)


def _deflated(values: NDArray[Any]) -> bytes:
    """Chunk as HDF5 stores it after its filters "shuffle" and "deflate"."""
    size = values.dtype.itemsize
    shuffled = np.ascontiguousarray(values).reshape(-1).view(np.uint8).reshape(-1, size).T
    return isal_zlib.compress(np.ascontiguousarray(shuffled), _DEFLATE)


def _chunk(values: xr.DataArray | xr.Variable) -> tuple[int, ...]:
    """Chunk of an array."""
    return values.shape if values.dims[0] == "y" else (1, *values.shape[1:])


def _write_zarr(path: Path, cube: xr.Dataset) -> None:
    """Write a picture as a Zarr group (format 3) in an uncompressed zip file."""
    from zarr.codecs import BloscCodec
    from zarr.storage import MemoryStore

    members: dict[str, Any] = {}
    codec = BloscCodec(cname="zstd", clevel=_ZSTANDARD, shuffle="shuffle")
    encoding = {str(name): {"compressors": (codec,), "chunks": _chunk(value)} for name, value in cube.data_vars.items()}
    cube.to_zarr(MemoryStore(members), mode="w", zarr_format=3, consolidated=False, encoding=encoding)
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(members):
            archive.writestr(zipfile.ZipInfo(name, _DATE), members[name].to_bytes())


def open_picture(path: Path) -> xr.Dataset:
    """Picture of a file, its values read on demand.

    Parameters
    ----------
    path
        File that ``write_picture`` wrote.

    Returns
    -------
    xr.Dataset
        The picture.

    Raises
    ------
    InputError
        If the file cannot be read, or its package is not installed.
    """
    if not path.name.endswith(PICTURE_ENDINGS["zarr"]):
        return open_netcdf(path)
    require_format("zarr", str(path))
    from zarr.storage import ZipStore

    try:
        store = ZipStore(path, mode="r")
        dataset = xr.open_zarr(store, consolidated=False, chunks=None)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a Zarr group in a zip file") from None
    dataset.set_close(store.close)
    return dataset


def write_copy(path: Path, cube: xr.Dataset) -> None:
    """Write the radiance of a picture in another format.

    Parameters
    ----------
    path
        File to write, with an ending of COPY_ENDINGS: spectral OpenEXR, ENVI, HDF5 as benchmarks of spectral recovery
        read it, or a preview.
    cube
        The picture.

    Raises
    ------
    InputError
        For another ending.
    """
    if path.suffix != COPY_ENDINGS["hdf5"]:
        write_cube(path, cube[["radiance", "surface"]].load())
        return
    radiance = cube["radiance"].values
    most = float(radiance.max())
    # in the order of Matlab, whose arrays HDF5 stores transposed
    content = {
        "cube": np.ascontiguousarray((radiance / (most or 1.0)).astype(np.float32).T),
        "bands": cube["wavelength"].values[:, None],
        "norm_factor": np.array([[most]]),
    }
    with writing_hdf5(path) as raw, h5py.File(raw, "w") as file:
        for name, values in content.items():
            stored = file.create_dataset(name, data=values, track_times=False)
            stored.attrs["MATLAB_class"] = np.bytes_("single" if values.dtype == np.float32 else "double")
