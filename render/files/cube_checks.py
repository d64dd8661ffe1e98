"""Checks of spectral cubes: radiance over y, x and wavelength, real and finite, in the right units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

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
    "with_units",
]

RADIANCE_UNIT = "W m^-2 sr^-1 nm^-1"

# Largest size of negative values relative to the positive ones.
_MOST_BELOW = 0.1

#: Attributes, text, by which a cube says where it comes from: the model file, the camera as JSON, and so on.
PROVENANCE = ("model", "camera", "seed", "cboxlab_version", "command")


def require_stored(cube: xr.Dataset, path: Path) -> None:
    """Raise InputError unless the dataset is a cube or the coefficients of one."""
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
    """Raise InputError unless ``cube`` has radiance over y, x and wavelength in the right units."""
    if "radiance" not in cube or set(cube["radiance"].dims) != {"y", "x", "wavelength"}:
        found = ", ".join(f"{name}{tuple(map(str, a.dims))}" for name, a in cube.data_vars.items()) or "nothing"
        raise InputError(f"{path}: radiance", found, "radiance with dimensions y, x, wavelength")
    _require_axis_and_units(cube, "radiance", path)


def _require_axis_and_units(cube: xr.Dataset, quantity: str, path: Path) -> None:
    if "wavelength" not in cube.coords or cube["wavelength"].dims != ("wavelength",):
        raise InputError(f"{path}: wavelength", "no coordinate", "the wavelengths in nm")
    if 0 in cube[quantity].shape:
        raise InputError(f"{path}: {quantity}", f"shape {cube[quantity].shape}", "at least one value")
    require_kinds(cube, quantity, path)
    if "standard_error" in cube and set(cube["standard_error"].dims) != {"y", "x", "wavelength"}:
        found = f"dimensions {', '.join(map(str, cube['standard_error'].dims))}"
        raise InputError(f"{path}: standard_error", found, "the dimensions of radiance")
    wavelength = cube["wavelength"].values
    twice = np.flatnonzero(np.diff(wavelength) == 0)
    if twice.size:
        raise InputError(f"{path}: wavelength", f"{wavelength[twice[0]]:g} nm twice", "each wavelength once")
    if not np.all(np.isfinite(wavelength)) or np.any(np.diff(wavelength) <= 0) or wavelength[0] <= 0:
        found = f"{wavelength.size} values of which some are not finite, not above 0, or do not ascend"
        raise InputError(f"{path}: wavelength", found, "ascending wavelengths in nm")
    for name, units in (("wavelength", "nm"), (quantity, RADIANCE_UNIT)):
        stated = cube[name].attrs.get("units", units)
        if stated != units:
            raise InputError(f"{path}: {name}", f"the unit '{stated}'", f"'{units}'", "Convert it first.")


def require_kinds(cube: xr.Dataset, quantity: str, path: Path) -> None:
    """Raise InputError for values that are no real numbers."""
    for name in ("wavelength", quantity, "standard_error"):
        if name in cube.variables and cube[name].dtype.kind not in "fiu":
            raise InputError(f"{path}: {name}", f"values of type {cube[name].dtype}", "real numbers")


def with_units(cube: xr.Dataset) -> xr.Dataset:
    """The cube with its units stated: a dataset in memory without any is in W m^-2 sr^-1 nm^-1 and nm."""
    arrays = {
        name: cube[name].assign_attrs({"units": RADIANCE_UNIT, **cube[name].attrs})
        for name in ("radiance", "standard_error")
        if name in cube
    }
    grid = cube["wavelength"]
    return cube.assign(arrays).assign_coords(wavelength=grid.assign_attrs({"units": "nm", **grid.attrs}))


def require_numbers(cube: xr.Dataset, path: Path) -> None:
    """Raises InputError for values that are not finite, and for standard errors below 0.

    NaN is accepted in a measured cube, which states by the attribute ``missing`` that it marks masked pixels.
    """
    missing = cube.attrs.get("missing") == "NaN"
    for name in ("radiance", "xyz", "standard_error"):
        if name not in cube:
            continue
        values = cube[name].values
        finite = ~np.isinf(values) if missing else np.isfinite(values)
        if not finite.all():
            first = dict(zip(map(str, cube[name].dims), map(int, np.argwhere(~finite)[0]), strict=True))
            count = int(values.size - finite.sum())
            found = f"{count} values that are not finite, the first at {first}"
            raise InputError(f"{path}: {name}", found, "finite numbers")
    if "standard_error" in cube and (cube["standard_error"].values < 0).any():
        raise InputError(f"{path}: standard_error", "a value below 0", "0 or more")


def negative_pixels(picture: xr.Dataset) -> int:
    """How many pixels have a value below 0 by more than a millionth of the mean."""
    values = picture["radiance" if "radiance" in picture else "xyz"]
    below = values < -1e-6 * float(np.abs(values).mean())
    return int(below.any(dim=[d for d in values.dims if d not in ("y", "x")]).sum())


def require_light(picture: xr.Dataset, source: Path | str) -> None:
    """Raises InputError where a tenth of the light is below 0, more than filters with negative lobes or noise leave."""
    values = picture["radiance" if "radiance" in picture else "xyz"].values
    below, above = (float(np.abs(values.sum(where=side, dtype=float))) for side in (values < 0, values > 0))
    if below > _MOST_BELOW * above:
        share = below / (below + above)
        raise InputError(
            source,
            f"values below 0, {share:.0%} of the sum of all sizes",
            "light, which is never below 0",
            "A difference of two pictures is none; compare the two.",
        )


def as_cube(radiance: NDArray, wavelength_nm: ArrayLike, missing: bool = False) -> xr.Dataset:
    """The dataset of radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1. missing : whether NaN marks masked pixels."""
    wavelength = ("wavelength", np.asarray(wavelength_nm, float), {"units": "nm"})
    values = (("y", "x", "wavelength"), radiance, {"units": RADIANCE_UNIT})
    attributes = {"missing": "NaN"} if missing else {}
    return xr.Dataset({"radiance": values}, coords={"wavelength": wavelength}, attrs=attributes)


def float32_samples(cube: xr.Dataset) -> NDArray[np.float32]:
    """(y, x, wavelength)."""
    return cube["radiance"].transpose("y", "x", "wavelength").values.astype(np.float32)
