"""Cubes as coefficients of principal components.

The radiance is mean + Sum_k coefficient_k basis_k. Such a cube is a Dataset with coefficient (y, x, component), basis
(component, wavelength) and mean (wavelength). Coefficients and mean have the unit of radiance, the basis has none. The
cube's surface (y, x) is included if known. The sensor simulation accepts such a cube directly.
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

#: Rows of a cube that are processed at once, which limits memory.
_BLOCK_ROWS = 64


@dataclass(frozen=True, eq=False)
class SpectralBasis:
    """Principal components of the spectra of a cube."""

    #: (w,) wavelengths, nm.
    wavelength_nm: NDArray[np.float64]
    #: (w,) mean spectrum, in the unit of radiance.
    mean: NDArray[np.float64]
    #: (k, w) components, orthonormal, largest variance first.
    vectors: NDArray[np.float64]
    #: Share of the variance that they explain, 0 to 1.
    explained: float


def _blocks(cube: xr.Dataset) -> Iterator[NDArray[np.float64]]:
    """Radiance (rows, x, wavelength) of a cube, a few rows at a time."""
    radiance = cube["radiance"]
    rows = (slice(start, start + _BLOCK_ROWS) for start in range(0, cube.sizes["y"], _BLOCK_ROWS))
    return (radiance.isel(y=part).transpose("y", "x", "wavelength").values.astype(np.float64) for part in rows)


def principal_components(cube: xr.Dataset, count: int) -> SpectralBasis:
    """First principal components of the spectra of all pixels.

    Parameters
    ----------
    cube
        Radiance (y, x, wavelength).
    count
        Number of components.

    Returns
    -------
    SpectralBasis
        The components.

    Raises
    ------
    InputError
        If the count is not between 1 and the number of wavelengths.
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
    total_variance = float(np.maximum(values, 0).sum())
    explained = 1.0 if total_variance == 0 else float(np.maximum(values[-count:], 0).sum()) / total_variance
    return SpectralBasis(wavelength, mean, vectors[:, ::-1][:, :count].T.copy(), explained)


def to_basis(cube: xr.Dataset, basis: SpectralBasis) -> xr.Dataset:
    """A cube in a basis, by least squares.

    Parameters
    ----------
    cube
        Radiance (y, x, wavelength), and surface if known.
    basis
        Basis at the same wavelengths.

    Returns
    -------
    Dataset
        coefficient, basis, mean, and surface if known.

    Raises
    ------
    InputError
        If the wavelengths differ.
    """
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
    """Radiance of a cube in a basis.

    Parameters
    ----------
    coefficients
        Dataset of `to_basis`.

    Returns
    -------
    Dataset
        radiance (y, x, wavelength), and surface if known. Radiance may be slightly negative, since the basis is
        truncated.
    """
    coefficient = coefficients["coefficient"].transpose("y", "x", "component")
    radiance = coefficient.values @ coefficients["basis"].values + coefficients["mean"].values
    data: dict[str, Any] = {"radiance": (("y", "x", "wavelength"), radiance, coefficient.attrs)}
    if "surface" in coefficients:
        data["surface"] = coefficients["surface"]
    return xr.Dataset(data, coords={"wavelength": coefficients["wavelength"]})


def spectral_error(cube: xr.Dataset, coefficients: xr.Dataset) -> float:
    """Relative error of the radiance in a basis: rms error over rms radiance.

    Parameters
    ----------
    cube
        Radiance (y, x, wavelength).
    coefficients
        The same cube in a basis.

    Returns
    -------
    float
        Relative error; 0 for a cube without light.
    """
    square_error = square_sum = 0.0
    for start, block in zip(range(0, cube.sizes["y"], _BLOCK_ROWS), _blocks(cube), strict=True):
        part = from_basis(coefficients.isel(y=slice(start, start + _BLOCK_ROWS)))["radiance"].values
        square_error += float(np.sum((block - part) ** 2))
        square_sum += float(np.sum(block**2))
    return float(np.sqrt(square_error / square_sum)) if square_sum > 0 else 0.0
