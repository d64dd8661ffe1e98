"""From spectral radiance to electrons per second in each channel, in blocks of rows.

A cube holds radiance (y, x, wavelength), or coefficients (y, x, component) of a spectral basis (``spectral_basis``).
Blocks are read on demand, so that a cube on disk can be larger than memory.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from .charge import leak
from .detector import SensorCamera, channel_map

__all__ = ["BLOCK_ROWS", "frame_shape", "integration_weights", "rate_blocks", "require_radiance"]

#: Largest share of a channel's integrated sensitivity outside a cube's wavelengths.
LARGEST_LOSS = 0.01
#: Rows in memory at once.
BLOCK_ROWS = 64
#: Standard errors by which a rendered radiance may be negative.
_NEGATIVE_SIGMAS = 6.0


def integration_weights(responsivity: Spectrum, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Weights w with w @ L = Int c(l) L(l) dl.

    Exact for c and L linear between their samples; structure of c finer than the samples of L is included.

    Parameters
    ----------
    responsivity
        c, of any wavelengths.
    wavelength_nm
        (n,) wavelengths of L, nm, ascending.

    Returns
    -------
    NDArray
        (n,) weights.

    Raises
    ------
    InputError
        If the wavelengths do not ascend, or more than LARGEST_LOSS of c lies outside them.
    """
    grid = np.asarray(wavelength_nm, float)
    if grid.ndim != 1 or grid.size < 2 or not np.all(np.diff(grid) > 0):
        shape_text = f"{grid.size} samples, shape {grid.shape}"
        raise InputError("cube: wavelength", shape_text, "two or more, ascending")
    table = responsivity.wavelength_nm
    knots = np.union1d(table, grid)
    left, right = knots[:-1], knots[1:]
    inside = (left >= max(table[0], grid[0])) & (right <= min(table[-1], grid[-1]))
    step, middle = right - left, (left + right) / 2
    weights = np.zeros(grid.size)
    for position, share in ((left, 1 / 6), (middle, 4 / 6), (right, 1 / 6)):  # Simpson: exact for a quadratic
        value = share * (step * responsivity.at(position))[inside]
        cell = np.clip(np.searchsorted(grid, position[inside], side="right") - 1, 0, grid.size - 2)
        part = (position[inside] - grid[cell]) / (grid[cell + 1] - grid[cell])
        np.add.at(weights, cell, value * (1 - part))
        np.add.at(weights, cell + 1, value * part)
    total = float(np.trapezoid(responsivity.values, table))
    if weights.sum() < (1 - LARGEST_LOSS) * total:
        coverage = f"which covers {weights.sum() / total:.1%} of a channel's sensitivity"
        raise InputError(
            "cube: wavelength",
            f"{grid[0]:g} to {grid[-1]:g} nm, {coverage}",
            f"at least {1 - LARGEST_LOSS:.0%} of the sensitivity, {table[0]:g} to {table[-1]:g} nm",
            "Render the cube over a wider range.",
        )
    return weights


def require_radiance(
    radiance: NDArray, wavelengths: int, standard_error: NDArray | None = None, first_row: int = 0
) -> None:
    """Raise InputError for radiance of another shape, negative or not finite.

    Parameters
    ----------
    radiance
        (y, x, w) radiance.
    wavelengths
        w.
    standard_error
        (y, x, w) of a Monte Carlo radiance, which may be negative by _NEGATIVE_SIGMAS times as much; 0 if None.
    first_row
        Row of the radiance in its cube, for the message.

    Raises
    ------
    InputError
        If a value is none of radiance, with its place.
    """
    if radiance.ndim != 3 or radiance.shape[-1] != wavelengths:
        shapes = f"shape {radiance.shape} for {wavelengths} wavelengths"
        raise InputError("cube: radiance", shapes, "(y, x, wavelength), one value per wavelength")
    if radiance.size == 0 or (radiance.min() >= 0 and radiance.max() < np.inf):
        return
    lowest = 0.0 if standard_error is None else -_NEGATIVE_SIGMAS * np.nan_to_num(standard_error)
    bad = ~(np.isfinite(radiance) & (radiance >= lowest))
    if bad.any():
        y, x, w = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"cube: radiance[{first_row + y}, {x}, {w}] (y, x, wavelength)",
            f"{radiance[y, x, w]:g}",
            "a finite number of 0 or more",
        )


def frame_shape(cube: xr.Dataset) -> tuple[int, int]:
    """Size of a cube's frames.

    Parameters
    ----------
    cube
        Dataset over y and x.

    Returns
    -------
    tuple of int
        Rows and columns.
    """
    return cube.sizes["y"], cube.sizes["x"]


def _rows(cube: xr.Dataset, name: str, rows: slice) -> NDArray:
    """Some rows of an array of a cube, (rows, x, ...)."""
    array = cube[name].isel(y=rows)
    return array.transpose("y", "x", ...).values


def _used_channels(camera: SensorCamera, channel: str | None) -> tuple[str, ...]:
    """The channels used in a frame."""
    letters = tuple(camera.channels)
    if camera.pattern is None:
        if channel is None and len(letters) == 1:
            channel = letters[0]
        if channel not in letters:
            description = "no channel" if channel is None else f"the channel '{channel}'"
            raise InputError(f"camera {camera.name}", description, f"one of {', '.join(letters)}")
        return (channel,)
    if channel is not None:
        expected = "none: a mosaic records all channels at once"
        raise InputError(f"camera {camera.name}", f"the channel '{channel}'", expected)
    return letters


def rate_blocks(
    cube: xr.Dataset, camera: SensorCamera, channel: str | None = None
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Rate of electrons in blocks of rows, after optics, sensitivity and leakage.

    Parameters
    ----------
    cube
        Radiance, or coefficients of a spectral basis.
    camera
        The camera.
    channel
        The filter, for a camera without mosaic that has several.

    Yields
    ------
    rows : slice
        Up to BLOCK_ROWS rows.
    rate : NDArray
        (rows, x) electrons per second.

    Raises
    ------
    InputError
        If the channel does not exist, and as ``integration_weights`` and ``require_radiance``.
    """
    used = _used_channels(camera, channel)
    wavelength = cube["wavelength"].values
    weights = np.stack([integration_weights(camera.channels[name], wavelength) for name in used], axis=-1)
    shape = frame_shape(cube)
    pattern = camera.pattern or ("-",)
    cell = channel_map(pattern, used if camera.pattern else ("-",), (len(pattern), len(pattern[0])))
    for start in range(0, shape[0], BLOCK_ROWS):
        stop = min(start + BLOCK_ROWS, shape[0])
        low, high = max(start - _halo(camera), 0), min(stop + _halo(camera), shape[0])
        plane = _light_on_sensor(cube, camera, weights, wavelength, slice(low, high), np.roll(cell, -low, axis=0))
        if camera.vignetting is not None:
            plane = plane * camera.vignetting.at(shape, slice(low, high))
        if any(camera.detector.leakage):
            plane = leak(plane, *camera.detector.leakage)
        yield slice(start, stop), plane[start - low : stop - low]


def _halo(camera: SensorCamera) -> int:
    """Rows next to a block that affect it."""
    return (0 if camera.blur is None else camera.blur.reach_px) + (1 if any(camera.detector.leakage) else 0)


def _light_on_sensor(
    cube: xr.Dataset,
    camera: SensorCamera,
    weights: NDArray[np.float64],
    wavelength: NDArray,
    rows: slice,
    cell: NDArray[np.int64],
) -> NDArray[np.float64]:
    """(rows, x) electrons per second after blur, before vignetting.

    cell : channels of the mosaic's letters, from the first row.
    """
    if "radiance" in cube:
        radiance = _rows(cube, "radiance", rows)
        error = _rows(cube, "standard_error", rows) if "standard_error" in cube else None
        require_radiance(radiance, wavelength.size, error, rows.start)
    else:
        coefficient, basis = _rows(cube, "coefficient", rows), cube["basis"].values
        mean = cube["mean"].values
        if not np.isfinite(coefficient).all():
            raise InputError("cube: coefficient", "a value that is not finite", "finite numbers")
        if camera.blur is None:
            return _weighted(coefficient, basis @ weights, mean @ weights, cell)
        radiance = coefficient @ basis + mean
    if camera.blur is not None:
        radiance = camera.blur.spread(radiance, wavelength, frame_shape(cube), rows)
    return _weighted(radiance, weights, np.zeros(weights.shape[1]), cell)


def _weighted(
    samples: NDArray, weights: NDArray[np.float64], offset: NDArray[np.float64], cell: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(y, x) samples (y, x, k) times weights (k, c) plus offset (c,) of each pixel's channel."""
    rate = np.empty(samples.shape[:2])
    down, right = cell.shape
    for y, x in np.ndindex(down, right):
        channel = cell[y, x]
        of_channel = samples[y::down, x::right].astype(np.float64)
        rate[y::down, x::right] = of_channel @ weights[:, channel] + offset[channel]
    return np.maximum(rate, 0.0, out=rate)
