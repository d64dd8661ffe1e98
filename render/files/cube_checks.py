"""Checks of spectral cubes: dimensions, real and finite numbers, units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from .headers import LONGEST_NM, SHORTEST_NM

__all__ = [
    "PROVENANCE",
    "RADIANCE_UNIT",
    "as_cube",
    "float32_samples",
    "negative_pixels",
    "require_cube",
    "require_kinds",
    "require_light",
    "require_numbers",
    "require_stored",
    "require_wavelengths_of_light",
    "with_units",
]

#: Unit of radiance in memory and in files of the program.
RADIANCE_UNIT = "W m^-2 sr^-1 nm^-1"

#: Largest sum of negative values over that of positive ones: negative lobes of filters and noise leave less.
_MAX_NEGATIVE_SHARE = 0.1

#: Attributes, text, by which a cube says where it comes from: the model file, the camera as JSON, and so on.
PROVENANCE = ("model", "camera", "seed", "cboxlab_version", "command")


def require_stored(cube: xr.Dataset, path: Path) -> None:
    """Raise InputError unless a dataset is a cube, or the coefficients of one.

    Parameters
    ----------
    cube
        The dataset.
    path
        File, for the message.

    Raises
    ------
    InputError
        If an array, its dimensions or its units are others.
    """
    if "coefficient" in cube:
        _require_coefficients(cube, path)
    else:
        require_cube(cube, path)


def _require_coefficients(cube: xr.Dataset, path: Path) -> None:
    dims = {
        "coefficient": ("y", "x", "component"),
        "basis": ("component", "wavelength"),
        "mean": ("wavelength",),
    }
    for name, expected in dims.items():
        if name not in cube or set(cube[name].dims) != set(expected):
            raise InputError(f"{path}: {name}", "no such array", f"an array over {', '.join(expected)}")
    _require_axis_and_units(cube, "coefficient", path)


def require_cube(cube: xr.Dataset, path: Path) -> None:
    """Raise InputError unless a dataset has radiance over y, x, wavelength, with units.

    Parameters
    ----------
    cube
        The dataset.
    path
        File, for the message.

    Raises
    ------
    InputError
        If an array, its dimensions or its units are others.
    """
    if "radiance" not in cube or set(cube["radiance"].dims) != {"y", "x", "wavelength"}:
        arrays = ", ".join(f"{name}{tuple(map(str, a.dims))}" for name, a in cube.data_vars.items()) or "nothing"
        raise InputError(f"{path}: radiance", arrays, "radiance with dimensions y, x, wavelength")
    _require_axis_and_units(cube, "radiance", path)


def _require_axis_and_units(cube: xr.Dataset, quantity: str, path: Path) -> None:
    if "wavelength" not in cube.coords or cube["wavelength"].dims != ("wavelength",):
        raise InputError(f"{path}: wavelength", "no coordinate", "the wavelengths in nm")
    if 0 in cube[quantity].shape:
        raise InputError(f"{path}: {quantity}", f"shape {cube[quantity].shape}", "at least one value")
    require_kinds(cube, quantity, path)
    if "standard_error" in cube and set(cube["standard_error"].dims) != {"y", "x", "wavelength"}:
        description = f"dimensions {', '.join(map(str, cube['standard_error'].dims))}"
        raise InputError(f"{path}: standard_error", description, "the dimensions of radiance")
    wavelength = cube["wavelength"].values
    twice = np.flatnonzero(np.diff(wavelength) == 0)
    if twice.size:
        raise InputError(f"{path}: wavelength", f"{wavelength[twice[0]]:g} nm twice", "each wavelength once")
    if not np.all(np.isfinite(wavelength)) or np.any(np.diff(wavelength) <= 0) or wavelength[0] <= 0:
        description = f"{wavelength.size} values, some not finite, not above 0 or not ascending"
        raise InputError(f"{path}: wavelength", description, "ascending wavelengths in nm")
    for name, units in (("wavelength", "nm"), (quantity, RADIANCE_UNIT)):
        unit = cube[name].attrs.get("units", units)
        if unit != units:
            raise InputError(f"{path}: {name}", f"the unit '{unit}'", f"'{units}'", "Convert it first.")


def require_kinds(cube: xr.Dataset, quantity: str, path: Path) -> None:
    """Raise InputError for values that are no real numbers.

    Parameters
    ----------
    cube
        The dataset.
    quantity
        Name of the array next to wavelength and standard error.
    path
        File, for the message.

    Raises
    ------
    InputError
        If an array holds complex numbers, texts or times.
    """
    for name in ("wavelength", quantity, "standard_error"):
        if name in cube.variables and cube[name].dtype.kind not in "fiu":
            raise InputError(f"{path}: {name}", f"values of type {cube[name].dtype}", "real numbers")


def with_units(cube: xr.Dataset) -> xr.Dataset:
    """Cube with its units stated.

    Parameters
    ----------
    cube
        Cube; without units it is in W m^-2 sr^-1 nm^-1 and nm.

    Returns
    -------
    xr.Dataset
        The cube with the attribute ``units`` of each array.
    """
    arrays = {
        name: cube[name].assign_attrs({"units": RADIANCE_UNIT, **cube[name].attrs})
        for name in ("radiance", "standard_error")
        if name in cube
    }
    grid = cube["wavelength"]
    return cube.assign(arrays).assign_coords(wavelength=grid.assign_attrs({"units": "nm", **grid.attrs}))


def require_numbers(cube: xr.Dataset, path: Path, *, finite: bool = True) -> None:
    """Raise InputError for values that are not finite, and for standard errors below 0.

    NaN is accepted in a measured cube, which states by the attribute ``missing`` that it marks masked pixels.

    Parameters
    ----------
    cube
        Cube or picture in colour.
    path
        File, for the message.
    finite
        Whether values have to be finite.

    Raises
    ------
    InputError
        If a value is not finite, with the first place, or a standard error is below 0.
    """
    missing = cube.attrs.get("missing") == "NaN"
    for name in ("radiance", "xyz", "rgb", "standard_error"):
        if name not in cube or not finite:
            continue
        values = cube[name].values
        sound = ~np.isinf(values) if missing else np.isfinite(values)
        if not sound.all():
            first = dict(zip(map(str, cube[name].dims), map(int, np.argwhere(~sound)[0]), strict=True))
            count = int(values.size - sound.sum())
            fault = f"{count} values that are not finite, the first at {first}"
            raise InputError(f"{path}: {name}", fault, "finite numbers")
    if "standard_error" in cube and (cube["standard_error"].values < 0).any():
        raise InputError(f"{path}: standard_error", "a value below 0", "0 or more")


def _light(picture: xr.Dataset) -> xr.DataArray:
    """Radiance, X, Y, Z, or R, G, B of a picture."""
    return next(picture[name] for name in ("radiance", "xyz", "rgb") if name in picture)


def negative_pixels(picture: xr.Dataset) -> int:
    """Number of pixels with a value below 0 by more than a millionth of the mean.

    Parameters
    ----------
    picture
        Cube or picture in colour.

    Returns
    -------
    int
        The number.
    """
    values = _light(picture)
    if not (values.values < 0).any():
        return 0
    below = values < -1e-6 * float(abs(values).where(np.isfinite(values)).mean())
    return int(below.any(dim=[d for d in values.dims if d not in ("y", "x")]).sum())


def require_light(picture: xr.Dataset, source: Path | str) -> None:
    """Raise InputError where a tenth of the light is below 0.

    Parameters
    ----------
    picture
        Cube or picture in colour.
    source
        File, for the message.

    Raises
    ------
    InputError
        If negative values sum up to more than filters with negative lobes, or noise, leave.
    """
    values = _light(picture).values
    finite = np.isfinite(values)
    signs = (values < 0) & finite, (values > 0) & finite
    below, above = (float(np.abs(values.sum(where=sign, dtype=float))) for sign in signs)
    if below > _MAX_NEGATIVE_SHARE * above:
        share = below / (below + above)
        raise InputError(
            source,
            f"values below 0, {share:.0%} of the sum of all sizes",
            "light, which is never below 0",
            "A difference of two pictures is none; compare the two.",
        )


def require_wavelengths_of_light(cube: xr.Dataset, path: Path) -> None:
    """Raise InputError for wavelengths that are none of light, such as 0.4 nm for 0.4 um.

    Parameters
    ----------
    cube
        Cube, or coefficients of one.
    path
        File, for the message.

    Raises
    ------
    InputError
        If a wavelength lies outside 100 nm to 0.1 mm.
    """
    wavelengths = cube["wavelength"].values
    low, high = float(wavelengths.min()), float(wavelengths.max())
    if not (low >= SHORTEST_NM and high <= LONGEST_NM):
        raise InputError(
            f"{path}: wavelength",
            f"{low:g} to {high:g} nm",
            f"wavelengths of light, {SHORTEST_NM:g} to {LONGEST_NM:g} nm",
            "Are they in another unit, such as um in place of nm?",
        )


def as_cube(radiance: NDArray, wavelength_nm: ArrayLike, missing: bool = False) -> xr.Dataset:
    """Dataset of a spectral cube.

    Parameters
    ----------
    radiance
        (y, x, wavelength) radiance, W m^-2 sr^-1 nm^-1.
    wavelength_nm
        (wavelength,) nm.
    missing
        Whether NaN marks masked pixels.

    Returns
    -------
    xr.Dataset
        ``radiance`` with its units.
    """
    wavelength = ("wavelength", np.asarray(wavelength_nm, float), {"units": "nm"})
    values = (("y", "x", "wavelength"), radiance, {"units": RADIANCE_UNIT})
    attributes = {"missing": "NaN"} if missing else {}
    return xr.Dataset({"radiance": values}, coords={"wavelength": wavelength}, attrs=attributes)


def float32_samples(cube: xr.Dataset) -> NDArray[np.float32]:
    """Radiance of a cube for files of float32.

    Parameters
    ----------
    cube
        The cube.

    Returns
    -------
    NDArray
        (y, x, wavelength) float32.
    """
    return cube["radiance"].transpose("y", "x", "wavelength").values.astype(np.float32)
