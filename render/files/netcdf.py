"""NetCDF files of complete datasets.

Files with arrays that are stored elsewhere, or of impossible sizes, are not read.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import writing_hdf5
from cboxlab.utils.input_files import require_regular_file
from cboxlab.utils.limits import MAX_CUBE_VALUES, require_size

from .cube_checks import RADIANCE_UNIT, require_kinds
from .declared import AS_STATED, Declared, spectral_factor, with_declarations
from .headers import in_nanometres, states_no_unit

__all__ = ["open_netcdf", "read_netcdf", "write_netcdf"]

#: Bytes of values that one stored byte can hold: deflate compresses by 1032 at most.
_MAX_COMPRESSION = 1100

#: Size of an array, bytes, up to which it may hold no stored values: memory for it does no harm.
_SMALL_BYTES = 2**26


def write_netcdf(path: Path, cube: xr.Dataset) -> None:
    """Write all variables, deflated.

    Parameters
    ----------
    path
        File to write.
    cube
        Any dataset.
    """
    packed = {str(name): {"zlib": True, "complevel": 4} for name in cube.data_vars}
    with writing_hdf5(path) as file:
        cube.to_netcdf(file, engine="h5netcdf", encoding=packed)


def open_netcdf(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Dataset of a file, its values read on demand.

    Parameters
    ----------
    path
        NetCDF file, of version 4 or a classic one.
    declared
        Units, scale, wavelengths or their unit, where the file does not state them.

    Returns
    -------
    xr.Dataset
        Radiance in W m^-2 sr^-1 nm^-1, wavelength in nm, ascending; other variables as they are.

    Raises
    ------
    InputError
        If the file cannot be read, holds links or values of other files, or leaves units open.
    """
    engine = "scipy" if _is_classic(path) else "h5netcdf"  # a classic file has no links, and all of its bytes
    if engine == "h5netcdf":
        _require_own_arrays(path)
    try:
        dataset = xr.open_dataset(path, engine=engine, cache=False)
    except Exception as error:  # h5netcdf, SciPy and xarray raise exceptions of any type on unusual attributes
        raise InputError(path, f"a file that cannot be read ({error})", "a NetCDF-4 file") from None
    return _in_our_units(path, dataset, declared) if "radiance" in dataset else dataset


def _in_our_units(path: Path, dataset: xr.Dataset, declared: Declared) -> xr.Dataset:
    """Radiance and its errors in W m^-2 sr^-1 nm^-1, wavelengths in nm, ascending."""
    require_kinds(dataset, "radiance", path)
    file_unit, used = dataset["radiance"].attrs.get("units"), []
    factor = spectral_factor(f"{path}: radiance", file_unit, declared)
    if file_unit is None:
        used += ["units", "scale"]
    for name in ("radiance", "standard_error"):
        if name in dataset and (factor != 1 or dataset[name].attrs.get("units") != RADIANCE_UNIT):
            values = dataset[name] if factor == 1 else dataset[name] * factor
            dataset[name] = values.assign_attrs({**dataset[name].attrs, "units": RADIANCE_UNIT})
    of_file: dict[str, object] = {} if file_unit is None else {"units": file_unit}
    if dataset.sizes.get("wavelength") and "wavelength" in dataset.coords:
        unit = dataset["wavelength"].attrs.get("units")
        if states_no_unit(unit):
            dataset, field = _with_wavelengths(path, dataset, declared)
            used.append(field)
        else:
            grid = in_nanometres(dataset["wavelength"].values, unit)
            if grid is None:
                raise InputError(f"{path}: wavelength", f"the unit '{unit}'", "nm, um or m")
            of_file["wavelength_unit"] = unit
            if unit != "nm":
                dataset = dataset.assign_coords(wavelength=("wavelength", grid, {"units": "nm"}))
        descending = np.all(np.diff(dataset["wavelength"].values) < 0)
        if descending:
            dataset = dataset.isel(wavelength=slice(None, None, -1))
    return with_declarations(dataset, declared, used, file_values=of_file)


def _with_wavelengths(path: Path, dataset: xr.Dataset, declared: Declared) -> tuple[xr.Dataset, str]:
    """Dataset with declared wavelengths, or in the declared unit, and the field that was used."""
    if declared.wavelength_unit is not None:
        grid = in_nanometres(dataset["wavelength"].values, declared.wavelength_unit)
        if grid is None:
            expected = "nm, um or another unit of length"
            raise InputError("declared wavelength-unit", f"'{declared.wavelength_unit}'", expected)
        return dataset.assign_coords(wavelength=("wavelength", grid, {"units": "nm"})), "wavelength_unit"
    if declared.wavelengths_nm is None:
        hint = "State the attribute units = 'nm'; declare wavelength-unit=nm, or declare wavelengths=400:700:20."
        raise InputError(f"{path}: wavelength", "no unit", "nm, um or m", hint)
    count = dataset.sizes["wavelength"]
    if len(declared.wavelengths_nm) != count:
        raise InputError(
            "declared wavelengths", f"{len(declared.wavelengths_nm)} wavelengths", f"{count}, as in {path}"
        )
    grid = np.array(declared.wavelengths_nm)
    return dataset.assign_coords(wavelength=("wavelength", grid, {"units": "nm"})), "wavelengths_nm"


def read_netcdf(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Dataset of a file in memory.

    Parameters
    ----------
    path
        NetCDF-4 file.
    declared
        As ``open_netcdf``.

    Returns
    -------
    xr.Dataset
        As ``open_netcdf``.

    Raises
    ------
    InputError
        As ``open_netcdf``, and for values that cannot be read or do not fit into memory.
    """
    with open_netcdf(path, declared) as file:
        require_size(path, max((array.size for array in file.values()), default=0), MAX_CUBE_VALUES, "values")
        try:
            return file.load()
        except MemoryError:
            raise InputError(path, "more than fits into memory", "a smaller cube") from None
        except Exception as error:  # as above, for the values
            raise InputError(path, f"values that cannot be read ({error})", "a NetCDF-4 file") from None


def _is_classic(path: Path) -> bool:
    """Whether a file is of the first NetCDF, with offsets of 32 or 64 bits."""
    require_regular_file(path, "a NetCDF file")
    try:
        with path.open("rb") as file:
            return file.read(4) in (b"CDF\x01", b"CDF\x02")
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be read") from None


def _require_own_arrays(path: Path) -> None:
    """Raise InputError for a file that is not HDF5, and for arrays that are not complete in it.

    An array may lie in another file, be assembled from others, or state more values than its bytes can hold.
    """
    require_regular_file(path, "a NetCDF-4 file")
    try:
        if not h5py.is_hdf5(path):
            with path.open("rb") as file:
                old = file.read(3) == b"CDF"
            description = "a NetCDF file of an older kind" if old else "a file that is not HDF5"
            raise InputError(path, description, "a NetCDF-4 file", "Convert it: nccopy -k nc4 OLD NEW." if old else "")
        with h5py.File(path, "r") as arrays:
            _require_group(path, arrays, set())
    except InputError:
        raise
    except Exception as error:  # the HDF5 library raises exceptions of any type on damaged files
        description = f"a file that cannot be read ({type(error).__name__}: {error})"
        raise InputError(path, description, "a NetCDF-4 file") from None


def _require_group(path: Path, group: h5py.Group, visited: set[bytes]) -> None:
    """Check the arrays of a group and of the groups in it; ``visited`` groups are passed over."""
    for name in group:
        where = f"{path}: {group.name.rstrip('/')}/{name}"
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise InputError(where, "a link", "an array in the file itself", "Store the array in this file.")
        member = group[name]
        if isinstance(member, h5py.Group):
            token = member.id.__hash__().to_bytes(8, "little", signed=True)
            if token not in visited:
                _require_group(path, member, visited | {token})
        elif isinstance(member, h5py.Dataset):
            _require_array(where, member)


def _require_array(where: str, array: h5py.Dataset) -> None:
    """Raise InputError for an array whose values are not complete in the file."""
    if array.external or array.is_virtual:
        hint = "Store the array in this file."
        raise InputError(where, "values that lie in another file", "values in the file itself", hint)
    size = array.size * array.dtype.itemsize if array.shape is not None else 0
    stored = array.id.get_storage_size()
    if size > _SMALL_BYTES and size > _MAX_COMPRESSION * stored:
        raise InputError(where, f"{stored} bytes for an array of {size} bytes", "an array that is complete")
