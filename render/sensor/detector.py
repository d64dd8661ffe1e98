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
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

from .optics import Blur, Vignetting

__all__ = ["Detector", "SensorCamera", "channel_map", "digitise", "noisy_counts", "quantise", "shot_noise"]

#: Largest mean of Poisson numbers, e-: more than any pixel holds; larger ones cannot be drawn.
_MAX_ELECTRONS = 1e18


@dataclass(frozen=True, eq=False)
class Detector:
    """The detector and its electronics."""

    #: Gain, e-/DN.
    gain_e_per_dn: float
    #: Counts are 0 to 2^bit_depth - 1.
    bit_depth: int
    #: (k,) exposures of the dark level, s; between them mean and variance are interpolated linearly, beyond them
    #: constant.
    dark_exposure_s: NDArray[np.float64]
    #: (k,) mean of a count without light, DN.
    dark_mean_dn: NDArray[np.float64]
    #: (k,) standard deviation of a count without light, before rounding, DN.
    dark_sigma_dn: NDArray[np.float64]
    #: Largest charge of a pixel, e-; None if the converter saturates first.
    full_well_e: float | None = None
    #: Whether charge above the full well flows along its column; otherwise it is drained.
    blooms: bool = False
    #: Share of a pixel's charge that goes to each neighbour in its row, in its column.
    leakage: tuple[float, float] = (0.0, 0.0)
    #: Standard deviation of the sensitivity over pixels, relative.
    sensitivity_spread: float = 0.0
    #: Standard deviation of the dark level over pixels, DN.
    offset_spread_dn: float = 0.0
    #: Seed of both patterns, which are the same in every frame of a camera.
    pattern_seed: int = 0
    #: (k,) linear DN of the static nonlinearity F, ascending; None for the identity.
    linear_dn: NDArray[np.float64] | None = None
    #: (k,) recorded DN of F, ascending; None for the identity.
    recorded_dn: NDArray[np.float64] | None = None

    @property
    def full_scale_dn(self) -> int:
        """The largest count."""
        return 2**self.bit_depth - 1

    def dark(self, exposure_s: float) -> tuple[float, float]:
        """Distribution of a count without light, before F and rounding.

        Parameters
        ----------
        exposure_s
            Exposure, s.

        Returns
        -------
        mean : float
            Mean, DN.
        sigma : float
            Standard deviation, DN.
        """
        mean, variance = (
            float(np.interp(exposure_s, self.dark_exposure_s, table))
            for table in (self.dark_mean_dn, self.dark_sigma_dn**2)
        )
        return mean, float(np.sqrt(variance))

    def record(self, linear_dn: ArrayLike) -> NDArray[np.float64]:
        """F: recorded counts of linear ones, not rounded.

        Parameters
        ----------
        linear_dn
            Linear DN of any shape.

        Returns
        -------
        NDArray
            Recorded DN; constant beyond the table.
        """
        values = np.asarray(linear_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.linear_dn, self.recorded_dn)

    def linearise(self, recorded_dn: ArrayLike) -> NDArray[np.float64]:
        """Inverse of F: linear counts of recorded ones.

        Parameters
        ----------
        recorded_dn
            Recorded DN of any shape.

        Returns
        -------
        NDArray
            Linear DN; constant beyond the table.
        """
        values = np.asarray(recorded_dn, float)
        if self.linear_dn is None or self.recorded_dn is None:
            return values
        return np.interp(values, self.recorded_dn, self.linear_dn)


@dataclass(frozen=True, eq=False)
class SensorCamera(FrozenMappings):
    """A camera for the simulation of counts."""

    #: Name in messages and files.
    name: str
    #: Responsivity c by letter (mosaic) or name (filters, one frame each), e- s^-1 per (W m^-2 sr^-1), zero beyond its
    #: table.
    channels: Mapping[str, Spectrum]
    #: Rows of letters of the mosaic, repeated over the sensor; None without a mosaic.
    pattern: tuple[str, ...] | None
    #: Detector and electronics.
    detector: Detector
    #: Source of the numbers.
    source: str
    #: Working f-number for which the channels are valid: f-number times image distance over focal length.
    f_number: float = 1.0
    #: Pixel pitch for which the channels are valid, um.
    pixel_pitch_um: float = 1.0
    #: Blur of the lens; None without.
    blur: Blur | None = None
    #: Vignetting of the lens; None without.
    vignetting: Vignetting | None = None

    def at_f_number(self, f_number: float) -> SensorCamera:
        """Camera at another f-number; the light is proportional to its inverse square.

        Parameters
        ----------
        f_number
            Working f-number.

        Returns
        -------
        SensorCamera
            Camera with scaled channels.
        """
        factor = (self.f_number / f_number) ** 2
        channels = {name: curve.scaled(factor) for name, curve in self.channels.items()}
        return replace(self, channels=channels, f_number=f_number)


def channel_map(pattern: tuple[str, ...], letters: tuple[str, ...], shape: tuple[int, int]) -> NDArray[np.int64]:
    """Channel of each pixel of a mosaic whose first row starts at pixel (0, 0).

    Parameters
    ----------
    pattern
        Rows of letters.
    letters
        Letters of the channels.
    shape
        Rows and columns of the frame.

    Returns
    -------
    NDArray
        (y, x) indices into ``letters``.

    Raises
    ------
    InputError
        If the pattern is empty or ragged, or has a letter without a channel.
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
    """Random numbers of electrons, Poisson distributed.

    Parameters
    ----------
    expected_e
        Expected electrons of any shape, 0 or more.
    generator
        Random numbers.

    Returns
    -------
    NDArray
        Electrons of the same shape.
    """
    return generator.poisson(np.minimum(expected_e, _MAX_ELECTRONS)).astype(np.float64)


def noisy_counts(
    expected_e: NDArray[np.float64],
    dark_mean_dn: ArrayLike,
    dark_sigma_dn: ArrayLike,
    detector: Detector,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Counts before rounding: shot noise, full well with a drain, gain, dark level, noise, F.

    Parameters
    ----------
    expected_e
        Expected electrons of any shape, 0 or more.
    dark_mean_dn, dark_sigma_dn
        Mean and standard deviation of a count without light, DN, broadcast against ``expected_e``.
    detector
        Gain, full well and F.
    generator
        Random numbers.

    Returns
    -------
    NDArray
        Counts of the same shape, DN.
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
    """Counts before rounding of numbers of electrons, see ``noisy_counts``.

    Parameters
    ----------
    electrons
        Electrons of any shape; the array is overwritten.
    dark_mean_dn, dark_sigma_dn, detector, generator
        As ``noisy_counts``.

    Returns
    -------
    NDArray
        Counts of the same shape, DN.
    """
    if detector.full_well_e is not None:
        np.minimum(electrons, detector.full_well_e, out=electrons)
    electrons /= detector.gain_e_per_dn
    electrons += np.asarray(dark_mean_dn)
    electrons += np.asarray(dark_sigma_dn) * generator.standard_normal(electrons.shape)
    return detector.record(electrons)


def quantise(counts: ArrayLike, bit_depth: int) -> NDArray[np.uint16]:
    """Counts rounded to integers and clipped to the bit depth.

    Parameters
    ----------
    counts
        Counts of any shape, DN.
    bit_depth
        Bits of a count.

    Returns
    -------
    NDArray
        0 to 2^bit_depth - 1.
    """
    return np.clip(np.rint(counts), 0, 2**bit_depth - 1).astype(np.uint16)
