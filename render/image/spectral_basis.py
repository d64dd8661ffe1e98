"""Cubes as coefficients of principal components: radiance = mean + Sum_k coefficient_k basis_k.

Such a cube is a Dataset with coefficient (y, x, component), basis (component, wavelength) and mean (wavelength),
in the unit of radiance (the basis has none), and the cube's surface (y, x) if known. The sensor simulation accepts it
directly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["SpectralBasis", "from_basis", "principal_components", "spectral_error", "to_basis"]

_ROWS = 64


@dataclass(frozen=True, eq=False)
class SpectralBasis:
    """wavelength_nm : (w,). mean : (w,). vectors : (k, w), orthonormal. explained : share of variance, 0 to 1."""

    wavelength_nm: NDArray[np.float64]
    mean: NDArray[np.float64]
    vectors: NDArray[np.float64]
    explained: float


def _blocks(cube: xr.Dataset) -> Iterator[NDArray[np.float64]]:
    radiance = cube["radiance"]
    rows = (slice(start, start + _ROWS) for start in range(0, cube.sizes["y"], _ROWS))
    return (radiance.isel(y=part).transpose("y", "x", "wavelength").values.astype(np.float64) for part in rows)


def principal_components(cube: xr.Dataset, count: int) -> SpectralBasis:
    """The first ``count`` principal components of the spectra of all pixels.

    Raises InputError for a count that is not between 1 and the number of wavelengths.
    """
    wavelength = cube["wavelength"].values.astype(float)
    if not 1 <= count <= wavelength.size:
        raise InputError("basis: components", str(count), f"1 to {wavelength.size}")
    number = cube.sizes["y"] * cube.sizes["x"]
    total = np.zeros(wavelength.size)
    for block in _blocks(cube):
        total += block.sum(axis=(0, 1))
    mean = total / number
    scatter = np.zeros((wavelength.size, wavelength.size))
    for block in _blocks(cube):
        centred = (block - mean).reshape(-1, wavelength.size)
        scatter += centred.T @ centred
    values, vectors = np.linalg.eigh(scatter)
    whole = float(np.maximum(values, 0).sum())
    explained = 1.0 if whole == 0 else float(np.maximum(values[-count:], 0).sum()) / whole
    return SpectralBasis(wavelength, mean, vectors[:, ::-1][:, :count].T.copy(), explained)


def to_basis(cube: xr.Dataset, basis: SpectralBasis) -> xr.Dataset:
    """The cube in a basis, by least squares. Raises InputError if the wavelengths differ."""
    wavelength = cube["wavelength"].values.astype(float)
    if not np.array_equal(wavelength, basis.wavelength_nm):
        ends = (f"{grid[0]:g} to {grid[-1]:g} nm in {grid.size}" for grid in (wavelength, basis.wavelength_nm))
        raise InputError("cube: wavelength", next(ends), f"those of the basis, {next(ends)} samples")
    inverse = np.linalg.pinv(basis.vectors)
    coefficient = np.concatenate([(block - basis.mean) @ inverse for block in _blocks(cube)])
    units = {"units": cube["radiance"].attrs.get("units", "W m^-2 sr^-1 nm^-1")}
    data: dict[str, Any] = {
        "coefficient": (("y", "x", "component"), coefficient, units),
        "basis": (("component", "wavelength"), basis.vectors),
        "mean": (("wavelength",), basis.mean, units),
    }
    if "surface" in cube:
        data["surface"] = cube["surface"]
    return xr.Dataset(data, coords={"wavelength": ("wavelength", wavelength, {"units": "nm"})})


def from_basis(coefficients: xr.Dataset) -> xr.Dataset:
    """Radiance (y, x, wavelength) of a cube in a basis; it may be slightly negative, since the basis is truncated."""
    coefficient = coefficients["coefficient"].transpose("y", "x", "component")
    radiance = coefficient.values @ coefficients["basis"].values + coefficients["mean"].values
    data: dict[str, Any] = {"radiance": (("y", "x", "wavelength"), radiance, coefficient.attrs)}
    if "surface" in coefficients:
        data["surface"] = coefficients["surface"]
    return xr.Dataset(data, coords={"wavelength": coefficients["wavelength"]})


def spectral_error(cube: xr.Dataset, coefficients: xr.Dataset) -> float:
    """Root mean square error of the radiance in the basis, relative to the root mean square radiance."""
    missed = whole = 0.0
    for start, block in zip(range(0, cube.sizes["y"], _ROWS), _blocks(cube), strict=True):
        part = from_basis(coefficients.isel(y=slice(start, start + _ROWS)))["radiance"].values
        missed += float(np.sum((block - part) ** 2))
        whole += float(np.sum(block**2))
    return float(np.sqrt(missed / whole)) if whole > 0 else 0.0
