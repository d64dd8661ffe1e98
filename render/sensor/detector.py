"""The sensor model: from light to electrons, noise and counts.

After Vora, Farrell, Tietz and Brainard, "Image capture: simulation of sensor responses from hyperspectral images",
IEEE Trans. Image Processing 10(2), 2001, eqs. 1 and 2,

    r(m, n) = F(e Sum_k s(m, n, k) c(m, n, k) + noise), quantised,

with the light in electrons, to include shot noise:

    electrons = Poisson(t Int c(l) L(l) dl)                                                [e-]
    r = round(F(min(electrons, full well) / gain + dark(t) + sigma(t) N(0, 1)))            [DN]

clipped to 0 .. 2^bit_depth - 1. c is in electrons per second per (W m^-2 sr^-1), t in s, gain in e-/DN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import ArrayLike, NDArray

from .optics import Blur, Vignetting

__all__ = ["Detector", "SensorCamera", "channel_map", "digitise", "noisy_counts", "quantise", "shot_noise"]

#: More than any pixel holds; Poisson numbers of larger means cannot be drawn.
_MOST_ELECTRONS = 1e18


@dataclass(frozen=True, eq=False)
class Detector:
    """The detector and its electronics.

    gain_e_per_dn : e-/DN. bit_depth : counts are 0 to 2^bit_depth - 1.
    dark_exposure_s, dark_mean_dn, dark_sigma_dn : (k,) mean and standard deviation (before rounding) of a count
        without light, DN, by exposure; mean and variance are interpolated linearly, constant beyond.
    full_well_e : largest charge of a pixel, e-; None if the converter saturates first.
    blooms : whether charge above the full well flows along its column; otherwise it is drained.
    leakage : share of a pixel's charge that goes to each neighbour in its row, in its column.
    sensitivity_spread : standard deviation of the sensitivity over pixels, relative.
    offset_spread_dn : standard deviation of the dark level over pixels, DN. pattern_seed : of both patterns, which
        are the same in every frame of a camera.
    linear_dn, recorded_dn : (k,) the static nonlinearity F, both ascending; None for the identity.
    """

    gain_e_per_dn: float
    bit_depth: int
    dark_exposure_s: NDArray[np.float64]
    dark_mean_dn: NDArray[np.float64]
    dark_sigma_dn: NDArray[np.float64]
    full_well_e: float | None = None
    blooms: bool = False
    leakage: tuple[float, float] = (0.0, 0.0)
    sensitivity_spread: float = 0.0
    offset_spread_dn: float = 0.0
    pattern_seed: int = 0
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
        """F: recorded DN for linear DN (any shape), not rounded; constant beyond the table."""
        values = np.asarray(linear_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.linear_dn, self.recorded_dn)

    def linearise(self, recorded_dn: ArrayLike) -> NDArray[np.float64]:
        """The inverse of F: linear DN for recorded DN (any shape)."""
        values = np.asarray(recorded_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.recorded_dn, self.linear_dn)


@dataclass(frozen=True, eq=False)
class SensorCamera(OwnMappings):
    """A camera for the simulation of counts.

    channels : responsivity c by letter (mosaic) or name (filters, one frame each), e- s^-1 per (W m^-2 sr^-1), zero
        beyond its table. pattern : rows of letters, repeated over the sensor; None without a mosaic. source : of the
        numbers. f_number, pixel_pitch_um : for which the channels are valid; f_number is the working f-number (times
        image distance over focal length). blur, vignetting : of the lens; None for none.
    """

    name: str
    channels: Mapping[str, Spectrum]
    pattern: tuple[str, ...] | None
    detector: Detector
    source: str
    f_number: float = 1.0
    pixel_pitch_um: float = 1.0
    blur: Blur | None = None
    vignetting: Vignetting | None = None

    def at_f_number(self, f_number: float) -> SensorCamera:
        """The same camera at another f-number; the light is proportional to its inverse square."""
        factor = (self.f_number / f_number) ** 2
        channels = {name: curve.scaled(factor) for name, curve in self.channels.items()}
        return replace(self, channels=channels, f_number=f_number)


def channel_map(pattern: tuple[str, ...], letters: tuple[str, ...], shape: tuple[int, int]) -> NDArray[np.int64]:
    """(y, x) index into ``letters`` of each pixel of a mosaic whose first row starts at pixel (0, 0).

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


def shot_noise(expected_e: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.float64]:
    """Numbers of electrons, Poisson distributed. expected_e : >= 0 (any shape)."""
    return generator.poisson(np.minimum(expected_e, _MOST_ELECTRONS)).astype(np.float64)


def noisy_counts(
    expected_e: NDArray[np.float64],
    dark_mean_dn: ArrayLike,
    dark_sigma_dn: ArrayLike,
    detector: Detector,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Counts in DN before rounding: shot noise, full well with a drain, gain, dark level, read noise, F.

    expected_e : expected electrons >= 0 (any shape). dark_mean_dn, dark_sigma_dn : DN, broadcast against it.
    """
    electrons = shot_noise(expected_e, generator)
    return digitise(electrons, dark_mean_dn, dark_sigma_dn, detector, generator)


def digitise(
    electrons: NDArray[np.float64],
    dark_mean_dn: ArrayLike,
    dark_sigma_dn: ArrayLike,
    detector: Detector,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """``noisy_counts`` for given numbers of electrons; the array is overwritten."""
    if detector.full_well_e is not None:
        np.minimum(electrons, detector.full_well_e, out=electrons)
    electrons /= detector.gain_e_per_dn
    electrons += np.asarray(dark_mean_dn)
    electrons += np.asarray(dark_sigma_dn) * generator.standard_normal(electrons.shape)
    return detector.record(electrons)


def quantise(counts: ArrayLike, bit_depth: int) -> NDArray[np.uint16]:
    """Counts rounded to whole DN and clipped to 0 .. 2^bit_depth - 1."""
    return np.clip(np.rint(counts), 0, 2**bit_depth - 1).astype(np.uint16)
