"""From spectral radiance to the counts of any sensor: light, electrons, noise, counts.

The model is that of Vora, Farrell, Tietz and Brainard, "Image capture: simulation of sensor responses from
hyperspectral images", IEEE Trans. Image Processing 10(2), 2001, eqs. 1 and 2,

    r(m, n) = F(e Sum_k s(m, n, k) c(m, n, k) + noise), quantised,

with the light counted in electrons, so that shot noise has its place:

    electrons = Poisson(t Int c(l) L(l) dl)                                                [e-]
    r = round(F(min(electrons, full well) / gain + dark(t) + sigma(t) N(0, 1)))            [DN]

clipped to 0 .. 2^bit_depth - 1. c is in electrons per second per (W m^-2 sr^-1), t in s, gain in e-/DN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import ArrayLike, NDArray

from .image import LAMP

__all__ = [
    "Detector", "SensorCamera", "auto_exposure", "channel_map", "electron_rate", "expected_counts",
    "expected_electrons", "integration_weights", "noisy_counts", "quantise", "simulate",
]  # fmt: skip

#: Part of a channel's whole sensitivity that may lie outside a cube's wavelengths.
LARGEST_LOSS = 0.01
# A rendered radiance may fall below zero by this many of its own standard errors.
_NEGATIVE_SIGMAS = 6.0
_ROWS = 64


@dataclass(frozen=True, eq=False)
class Detector:
    """The electronics behind the light.

    gain_e_per_dn : e-/DN. bit_depth : counts run 0 .. 2^bit_depth - 1.
    dark_exposure_s, dark_mean_dn, dark_sigma_dn : (k,) level and spread (before rounding) of a count without
        light, DN, by exposure; mean and variance linear in between, held beyond.
    full_well_e : the charge that a pixel holds, e-; None where the converter saturates first.
    linear_dn, recorded_dn : (k,) the static nonlinearity F, both ascending; None for the identity.
    """

    gain_e_per_dn: float
    bit_depth: int
    dark_exposure_s: NDArray[np.float64]
    dark_mean_dn: NDArray[np.float64]
    dark_sigma_dn: NDArray[np.float64]
    full_well_e: float | None = None
    linear_dn: NDArray[np.float64] | None = None
    recorded_dn: NDArray[np.float64] | None = None

    @property
    def full_scale_dn(self) -> int:
        """The largest count."""
        return 2**self.bit_depth - 1

    def dark(self, exposure_s: float) -> tuple[float, float]:
        """Mean and standard deviation in DN of a count without light, before F and rounding."""
        mean, variance = (
            float(np.interp(exposure_s, self.dark_exposure_s, table))
            for table in (self.dark_mean_dn, self.dark_sigma_dn**2)
        )
        return mean, float(np.sqrt(variance))

    def record(self, linear_dn: ArrayLike) -> NDArray[np.float64]:
        """F: recorded DN for linear DN (any shape), neither of them rounded; held beyond the table."""
        values = np.asarray(linear_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.linear_dn, self.recorded_dn)

    def linearise(self, recorded_dn: ArrayLike) -> NDArray[np.float64]:
        """The inverse of F."""
        values = np.asarray(recorded_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.recorded_dn, self.linear_dn)


@dataclass(frozen=True, eq=False)
class SensorCamera:
    """A camera as far as its counts go.

    channels : responsivity c by letter (mosaic) or name (filters, one frame each), e- s^-1 per
        (W m^-2 sr^-1), zero beyond its table. pattern : rows of letters, repeated over the sensor; None
        where there is no mosaic. source : where the numbers come from.
    """

    name: str
    channels: dict[str, Spectrum]
    pattern: tuple[str, ...] | None
    detector: Detector
    source: str


def integration_weights(responsivity: Spectrum, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """(n,) w with w @ L = Int c(l) L(l) dl, exact for c and L linear between their samples.

    Thus a fine structure of c between the samples of L counts. Raises InputError for wavelengths that are
    not ascending, or that leave out more than LARGEST_LOSS of c.
    """
    grid = np.asarray(wavelength_nm, float)
    if grid.ndim != 1 or grid.size < 2 or not np.all(np.diff(grid) > 0):
        found = f"{grid.size} samples, shape {grid.shape}"
        raise InputError("cube: wavelength", found, "two or more, ascending")
    table = responsivity.wavelength_nm
    knots = np.union1d(table, grid)
    left, right = knots[:-1], knots[1:]
    kept = (left >= max(table[0], grid[0])) & (right <= min(table[-1], grid[-1]))
    step, middle = right - left, (left + right) / 2
    weights = np.zeros(grid.size)
    for place, share in ((left, 1 / 6), (middle, 4 / 6), (right, 1 / 6)):  # Simpson: exact for a quadratic
        value = share * (step * responsivity.at(place))[kept]
        cell = np.clip(np.searchsorted(grid, place[kept], side="right") - 1, 0, grid.size - 2)
        part = (place[kept] - grid[cell]) / (grid[cell + 1] - grid[cell])
        np.add.at(weights, cell, value * (1 - part))
        np.add.at(weights, cell + 1, value * part)
    whole = float(np.trapezoid(responsivity.values, table))
    if weights.sum() < (1 - LARGEST_LOSS) * whole:
        held = f"which hold {weights.sum() / whole:.1%} of a channel's sensitivity"
        raise InputError(
            "cube: wavelength",
            f"{grid[0]:g} to {grid[-1]:g} nm, {held}",
            f"at least {1 - LARGEST_LOSS:.0%} of what the camera sees, {table[0]:g} to {table[-1]:g} nm",
            "Render the cube over a wider range.",
        )
    return weights


def electron_rate(
    radiance: NDArray, weights: NDArray[np.float64], standard_error: NDArray | None = None
) -> NDArray[np.float64]:
    """Electrons per second (y, x, c) >= 0 of radiance (y, x, w), W m^-2 sr^-1 nm^-1, by weights (w, c).

    standard_error : (y, x, w) of a Monte Carlo radiance, which may scatter below zero by as much; 0 if None.

    Raises InputError for shapes that do not match, radiance that is negative or no finite number.
    """
    if radiance.ndim != 3 or radiance.shape[-1] != len(weights):
        found = f"shape {radiance.shape} for {len(weights)} wavelengths"
        raise InputError("cube: radiance", found, "(y, x, wavelength), as many as there are wavelengths")
    rate = np.empty((*radiance.shape[:2], weights.shape[1]))
    for start in range(0, len(radiance), _ROWS):
        rows = slice(start, start + _ROWS)
        block = radiance[rows].astype(np.float64)
        lowest = 0.0 if standard_error is None else -_NEGATIVE_SIGMAS * np.nan_to_num(standard_error[rows])
        bad = ~(np.isfinite(block) & (block >= lowest))
        if bad.any():
            y, x, w = (int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"cube: radiance[{start + y}, {x}, {w}] (y, x, wavelength)",
                f"{block[y, x, w]:g}",
                "a finite number of 0 or more",
            )
        rate[rows] = np.maximum(block @ weights, 0.0)
    return rate


def channel_map(
    pattern: tuple[str, ...], letters: tuple[str, ...], shape: tuple[int, int]
) -> NDArray[np.int64]:
    """(y, x) index into ``letters`` of each pixel behind a mosaic whose first row starts at pixel (0, 0).

    Raises InputError for an empty or ragged pattern and for a letter without a channel.
    """
    if not pattern or not pattern[0] or len({len(row) for row in pattern}) > 1:
        raise InputError("mosaic.pattern", repr(list(pattern)), "rows of letters, all of the same length")
    for row in pattern:
        for letter in row:
            if letter not in letters:
                expected = f"letters with a channel: {', '.join(letters)}"
                raise InputError("mosaic.pattern", f"the letter '{letter}'", expected)
    cell = np.array([[letters.index(letter) for letter in row] for row in pattern])
    tiles = [-(-size // length) for size, length in zip(shape, cell.shape, strict=True)]
    return np.tile(cell, tiles)[: shape[0], : shape[1]]


def noisy_counts(
    expected_e: NDArray[np.float64], dark_mean_dn: ArrayLike, dark_sigma_dn: ArrayLike, detector: Detector,
    generator: np.random.Generator,
) -> NDArray[np.float64]:  # fmt: skip
    """Counts in DN before rounding: shot noise, full well, gain, dark level, read noise, F.

    expected_e : expected electrons >= 0 (any shape). dark_mean_dn, dark_sigma_dn : DN, broadcast against it.
    """
    electrons = generator.poisson(expected_e).astype(np.float64)
    if detector.full_well_e is not None:
        np.minimum(electrons, detector.full_well_e, out=electrons)
    electrons /= detector.gain_e_per_dn
    electrons += np.asarray(dark_mean_dn)
    electrons += np.asarray(dark_sigma_dn) * generator.standard_normal(electrons.shape)
    return detector.record(electrons)


def quantise(counts: ArrayLike, bit_depth: int) -> NDArray[np.uint16]:
    """Counts rounded to whole DN and clipped to 0 .. 2^bit_depth - 1."""
    return np.clip(np.rint(counts), 0, 2**bit_depth - 1).astype(np.uint16)


def _expected_rate(cube: xr.Dataset, camera: SensorCamera, channel: str | None) -> NDArray[np.float64]:
    """(y, x) electrons per second."""
    letters = tuple(camera.channels)
    if camera.pattern is None:
        if channel is None and len(letters) == 1:
            channel = letters[0]
        if channel not in letters:
            found = "no channel" if channel is None else f"the channel '{channel}'"
            raise InputError(f"camera {camera.name}", found, f"one of {', '.join(letters)}")
        chosen: tuple[str, ...] = (channel,)
    elif channel is not None:
        expected = "none: a mosaic takes all at once"
        raise InputError(f"camera {camera.name}", f"the channel '{channel}'", expected)
    else:
        chosen = letters
    wavelength = cube["wavelength"].values
    weights = np.stack([integration_weights(camera.channels[name], wavelength) for name in chosen], axis=-1)
    radiance = cube["radiance"].transpose("y", "x", "wavelength").values
    error = None
    if "standard_error" in cube:
        error = cube["standard_error"].transpose("y", "x", "wavelength").values
    rate = electron_rate(radiance, weights, error)
    if camera.pattern is None:
        return rate[..., 0]
    place = channel_map(camera.pattern, letters, rate.shape[:2])
    return np.take_along_axis(rate, place[..., None], axis=-1)[..., 0]


def _require_exposure(exposure_s: float) -> None:
    if not (np.isfinite(exposure_s) and exposure_s > 0):
        raise InputError("exposure", f"{exposure_s:g} s", "a time above 0")


def expected_electrons(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, channel: str | None = None
) -> NDArray[np.float64]:
    """Expected photoelectrons (y, x), without dark charge and without the limit of the full well.

    cube : radiance (y, x, wavelength) as of ``RenderedImage.cube``. channel : the filter, of a camera
    without mosaic that has several. Raises InputError (see integration_weights, electron_rate).
    """
    _require_exposure(exposure_s)
    return exposure_s * _expected_rate(cube, camera, channel)


def expected_counts(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, channel: str | None = None
) -> NDArray[np.float64]:
    """Counts (y, x) in DN without noise and rounding, clipped to the bit depth: F of the expected input."""
    electrons = expected_electrons(cube, camera, exposure_s, channel)
    detector = camera.detector
    if detector.full_well_e is not None:
        electrons = np.minimum(electrons, detector.full_well_e)
    counts = detector.record(electrons / detector.gain_e_per_dn + detector.dark(exposure_s)[0])
    return np.clip(counts, 0, detector.full_scale_dn)


def simulate(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, seed: int, channel: str | None = None
) -> NDArray[np.uint16]:
    """One raw frame (y, x) in DN, repeatable by ``seed``. Arguments and errors as of expected_electrons."""
    electrons = expected_electrons(cube, camera, exposure_s, channel)
    mean, sigma = camera.detector.dark(exposure_s)
    counts = noisy_counts(electrons, mean, sigma, camera.detector, np.random.default_rng(seed))
    return quantise(counts, camera.detector.bit_depth)


def auto_exposure(
    cube: xr.Dataset, camera: SensorCamera, channel: str | None = None, level: float = 0.7
) -> float:
    """Seconds that bring the 99th percentile of the counts outside the lamp to ``level`` of full scale.

    Needed for cubes whose radiance is relative. Raises InputError for a dark cube.
    """
    detector = camera.detector
    rate = _expected_rate(cube, camera, channel)
    if "surface" in cube and np.any(cube["surface"].values != LAMP):
        rate = rate[cube["surface"].values != LAMP]
    bright = float(np.percentile(rate, 99))
    if bright <= 0:
        raise InputError("cube: radiance", "no light outside the lamp", "light, for an exposure to be chosen")
    wanted = float(detector.linearise(level * detector.full_scale_dn))
    exposure = wanted * detector.gain_e_per_dn / bright
    for _ in range(20):  # the dark level changes slowly with the exposure: this settles at once
        exposure = max(wanted - detector.dark(exposure)[0], 1.0) * detector.gain_e_per_dn / bright
    return exposure
