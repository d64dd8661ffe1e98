"""Noise of a count by photon transfer: gain and read noise from differences between repeats.

With x the count above bias (light and thermal charge), the variance of one count is

    var = x / gain + (read_noise / gain)^2 + 1/12    [DN^2]

where 1/12 is due to rounding to whole counts (Janesick, Photon Transfer, SPIE 2007). Fixed patterns cancel in the
differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..capture import Capture, DarkTable, FlatTable
from .dark import DarkLibrary

__all__ = ["ROUNDING_VARIANCE", "NoiseModel", "measure_noise"]

#: Variance of rounding to whole counts, DN^2.
ROUNDING_VARIANCE = 1.0 / 12.0

# Normal noise exceeds this many standard deviations once in 2.6e7 samples; samples beyond it are rejected as
# cosmic rays.
_OUTLIER_SIGMAS = 5.5
# Harmonics of the rounding error that are summed: without noise the rest is 1e-4 of its square.
_HARMONICS = 1000
# Read noise (DN) below which rounding hides it: most counts are then equal.
_HIDDEN_READ_NOISE_DN = 0.3


@dataclass(frozen=True)
class NoiseModel:
    """Gain (e-/DN) and read noise (e-, rms); None if neither measured nor stated in the manifest.

    The sigmas are one standard deviation, None for a value that is only stated in the manifest.
    """

    gain_e_per_dn: float | None
    gain_sigma: float | None
    read_noise_e: float | None
    read_noise_sigma: float | None
    notes: tuple[str, ...] = ()

    @property
    def shot_dn(self) -> float:
        """Variance per charge, DN^2/DN: 1 / gain; 0 if the gain is unknown."""
        return 0.0 if self.gain_e_per_dn is None else 1.0 / self.gain_e_per_dn

    @property
    def floor_dn2(self) -> float:
        """Variance of a count without charge (read noise and rounding), DN^2."""
        return (self.shot_dn * (self.read_noise_e or 0.0)) ** 2 + ROUNDING_VARIANCE

    @property
    def rounding_error_dn(self) -> float:
        """Error of a dark level by rounding, DN, rms over the levels between two counts; repeats do not lower it.

        Noise of sigma (DN) smooths the steps of the counts: the mean of rounded counts misses a level x by the sum
        over k of (-1)^k exp(-2 pi^2 k^2 sigma^2) sin(2 pi k x) / (pi k). It is 0.2 DN at sigma = 0.1, 0.002 at 0.5
        (Widrow and Kollar, Quantization Noise, 2008).
        """
        sigma_dn, k = self.shot_dn * (self.read_noise_e or 0.0), np.arange(1, _HARMONICS)
        waves = np.exp(-2 * (np.pi * k * sigma_dn) ** 2) / (np.pi * k)
        return float(np.sqrt(np.sum(waves**2) / 2))

    def variance(self, charge_dn: ArrayLike) -> NDArray[np.float64]:
        """Variance of one count in DN^2, given its expected value above bias in DN (any shape)."""
        return np.maximum(np.asarray(charge_dn, float), 0.0) * self.shot_dn + self.floor_dn2


@dataclass(frozen=True, eq=False)
class _Samples:
    charge: NDArray[np.float64]
    variance: NDArray[np.float64]
    degrees: int


def _samples(
    stack: NDArray[np.uint16],
    bias: NDArray[np.float64],
    saturation: int,
    is_dark: bool,
) -> _Samples:
    counts = stack.astype(float)
    good = (stack.max(axis=0) < saturation) & (stack.min(axis=0) > 0)
    # Subtract each repeat's mean deviation: the light may have changed between repeats.
    counts -= (counts - counts.mean(axis=0))[:, good].mean(axis=1)[:, None, None]
    charge = counts.mean(axis=0) - bias
    if is_dark:
        # The noise of the dark charge of a pixel is as large as the charge and would bias the slope of the line.
        # Since variance is linear in charge, the mean charge of the ordinary pixels can be used instead.
        middle = np.median(charge[good])
        spread = 1.4826 * np.median(np.abs(charge[good] - middle))
        good &= np.abs(charge - middle) <= _OUTLIER_SIGMAS * max(spread, ROUNDING_VARIANCE)
        charge = np.full_like(charge, charge[good].mean())
    return _Samples(charge[good], counts.var(axis=0, ddof=1)[good], stack.shape[0] - 1)


def _fit_line(samples: list[_Samples]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(floor, slope) of variance against charge and their covariance, by iteratively reweighted least squares.

    Sample variances are chi-square distributed with a standard deviation proportional to their expectation. The
    weights are computed from the fitted line; weights from the samples would bias the fit low.
    """
    charge = np.concatenate([s.charge for s in samples])
    variance = np.concatenate([s.variance for s in samples])
    degrees = np.concatenate([np.full(s.charge.size, float(s.degrees)) for s in samples])
    line: NDArray[np.float64] = np.ones(2)
    keep = np.ones(charge.size, bool)
    normal: NDArray[np.float64] = np.eye(2)
    for _ in range(20):
        model = np.maximum(line[0] + line[1] * charge, ROUNDING_VARIANCE)
        weight = keep * degrees / (2 * model**2)
        cross = np.sum(weight * charge)
        normal = np.array([[weight.sum(), cross], [cross, np.sum(weight * charge**2)]])
        line = np.linalg.solve(normal, [np.sum(weight * variance), np.sum(weight * charge * variance)])
        keep = variance < _OUTLIER_SIGMAS**2 * np.maximum(line[0] + line[1] * charge, ROUNDING_VARIANCE)
    return line, np.asarray(np.linalg.inv(normal), np.float64)


def measure_noise(capture: Capture, dark: DarkLibrary) -> NoiseModel:
    """Gain and read noise from repeated flat and dark frames, else from the manifest.

    A measured value replaces a stated one; a difference of more than five standard deviations is noted. Raises
    InputError for a faulty frame.
    """
    camera, notes = capture.manifest.camera, []
    flats = [flat for flat in capture.manifest.flats if len(flat.frames) > 1]
    darks = [table for table in capture.manifest.darks if len(table.frames) > 1]
    gain, gain_sigma = camera.gain_e_per_dn, None
    read, read_sigma = camera.read_noise_e, None
    usable_darks = darks if not dark.clipped else []
    if dark.clipped:
        notes.append(
            "the dark frames are clipped at 0 DN: read noise and a negative offset cannot be measured from them"
        )
    if not flats:
        notes.append("gain not measured: no flat with repeats")
    if not usable_darks:
        notes.append("read noise not measured: no usable dark frames with repeats")
    tables: list[FlatTable | DarkTable] = [*flats, *usable_darks]
    if tables and (flats or gain is not None):
        samples = [
            _samples(
                capture.frames(table),
                dark.bias,
                capture.saturation_dn,
                isinstance(table, DarkTable),
            )
            for table in tables
        ]
        (floor, slope), covariance = _fit_line(samples)
        if flats:
            gain, gain_sigma = float(1 / slope), float(np.sqrt(covariance[1, 1]) / slope**2)
        if usable_darks:
            read_variance = floor - ROUNDING_VARIANCE
            if read_variance > _HIDDEN_READ_NOISE_DN**2 and gain is not None:
                gradient = np.array([gain / (2 * np.sqrt(read_variance)), 0.0])
                if flats:
                    gradient[1] = -np.sqrt(read_variance) * gain**2
                read = float(np.sqrt(read_variance) * gain)
                read_sigma = float(np.sqrt(gradient @ covariance @ gradient))
            else:
                notes.append("read noise not measured: rounding to whole counts hides it")
    for name, stated, value, sigma in (
        ("gain", camera.gain_e_per_dn, gain, gain_sigma),
        ("read noise", camera.read_noise_e, read, read_sigma),
    ):
        if stated is not None and value is not None and sigma is not None and abs(stated - value) > 5 * sigma:
            notes.append(
                f"{name}: the manifest states {stated:g}, the frames show {value:.4g} +- {sigma:.2g}"
            )
    if gain is None:
        notes.append("gain unknown: no variance includes shot noise or read noise")
    return NoiseModel(gain, gain_sigma, read, read_sigma, tuple(notes))
