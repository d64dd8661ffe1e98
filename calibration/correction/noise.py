"""Noise of a count by photon transfer: gain and read noise from differences between repeats.

With x the count above bias (light and thermal charge), the variance of one count is

    var = x / gain + (read_noise / gain)^2 + 1/12    [DN^2]

where 1/12 is due to rounding to whole counts (Janesick, Photon Transfer, SPIE 2007). Fixed patterns cancel in the
differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..capture import Capture, FlatTable, FrameTable
from .dark import DarkLibrary
from .picture_noise import clipped_variance, second_differences
from .repeat_light import LIGHT_CHANGE_NOTED, light_change, with_steady_light

__all__ = ["ROUNDING_VARIANCE", "NoiseModel", "measure_noise"]

#: Variance of rounding to whole counts, DN^2.
ROUNDING_VARIANCE = 1.0 / 12.0

#: Standard deviations beyond which a sample is a cosmic ray: normal noise exceeds it once in 2.6e7 samples.
_OUTLIER_SIGMAS = 5.5
#: Harmonics of the rounding error that are summed: without noise the rest is 1e-4 of its square.
_HARMONICS = 1000
#: Variance of dark counts below which rounding dominates, DN^2: half way between two counts rounding alone gives 1/4.
#: The true variance then lies between that of rounding and this value (compare 0.24 in EMVA 1288).
_ROUNDED_VARIANCE = 0.3
#: Where the shot noise of a count comes from: repeats of flats, the manifest, repeats of the bands, neighbouring pixels
#: of the bands, or nowhere.
NoiseSource = Literal["flats", "stated", "band repeats", "estimated", "unknown"]

#: Levels of light in a picture whose noise is taken from neighbours.
_PICTURE_LEVELS = 12
#: An unknown value and its standard deviation.
_UNKNOWN = (0.0, np.inf)
#: Sources whose line of variance against charge reaches dark pixels, so that its start is the read noise.
_OF_BANDS = ("band repeats", "estimated")


@dataclass(frozen=True)
class NoiseModel:
    """Gain and read noise of the sensor. A sigma is one standard deviation.

    A value is None if it was neither measured nor stated in the manifest. Its sigma is None if it is only stated.
    """

    #: Electrons per count, e-/DN.
    gain_e_per_dn: float | None
    #: Standard deviation of the gain, e-/DN.
    gain_sigma: float | None
    #: Root mean square read noise, e-.
    read_noise_e: float | None
    #: Standard deviation of the read noise, e-.
    read_noise_sigma: float | None
    #: What could not be measured, and contradictions with the manifest, one sentence each.
    notes: tuple[str, ...] = ()
    #: Where the shot noise comes from.
    source: NoiseSource = "flats"
    #: Variance of rounding, DN^2; 0 for merged pictures of floating-point values.
    rounding_dn2: float = ROUNDING_VARIANCE

    @property
    def shot_dn(self) -> float:
        """Variance per charge, DN^2/DN: 1 / gain; 0 if the gain is unknown."""
        return 0.0 if self.gain_e_per_dn is None else 1.0 / self.gain_e_per_dn

    @property
    def floor_dn2(self) -> float:
        """Variance of a count without charge (read noise and rounding), DN^2."""
        return (self.shot_dn * (self.read_noise_e or 0.0)) ** 2 + self.rounding_dn2

    @property
    def rounding_error_dn(self) -> float:
        """Error of a dark level by rounding, DN, rms over the levels between two counts.

        Repeats do not lower it. Noise of sigma (DN) smooths the steps of the counts. The mean of rounded counts
        misses a level x by the sum over k of (-1)^k exp(-2 pi^2 k^2 sigma^2) sin(2 pi k x) / (pi k). It is 0.2 DN at
        sigma = 0.1, 0.002 at 0.5 (Widrow and Kollar, Quantization Noise, 2008).
        """
        if self.rounding_dn2 == 0:
            return 0.0
        sigma_dn, k = self.shot_dn * (self.read_noise_e or 0.0), np.arange(1, _HARMONICS)
        waves = np.exp(-2 * (np.pi * k * sigma_dn) ** 2) / (np.pi * k)
        return float(np.sqrt(np.sum(waves**2) / 2))

    def variance(self, charge_dn: ArrayLike) -> NDArray[np.float64]:
        """Variance of one count.

        Parameters
        ----------
        charge_dn
            Expected value above bias, any shape, DN; negative values count as 0.

        Returns
        -------
        NDArray
            Variance in the same shape, DN^2.
        """
        return np.maximum(np.asarray(charge_dn, float), 0.0) * self.shot_dn + self.floor_dn2


@dataclass(frozen=True, eq=False)
class _Samples:
    """Variances of single pixels against their charge, of one table."""

    #: (n,) charge above bias, DN.
    charge: NDArray[np.float64]
    #: (n,) variance over repeats, DN^2.
    variance: NDArray[np.float64]
    #: Degrees of freedom of each variance, repeats - 1.
    degrees: int


def _samples(
    stack: NDArray[np.uint16],
    bias: NDArray[np.float64],
    saturation: int,
    is_dark: bool,
) -> _Samples:
    """Charge and variance of the usable pixels of repeats (repeat, y, x).

    Bright repeats that are copies of one frame give no samples.
    """
    counts = stack.astype(float)
    good = (stack.max(axis=0) < saturation) & (stack.min(axis=0) > 0)
    copied = not is_dark and bool((stack == stack[0]).all())
    if copied or not np.any(good):
        return _Samples(np.zeros(0), np.zeros(0), stack.shape[0] - 1)
    if is_dark:
        counts -= (counts - counts.mean(axis=0))[:, good].mean(axis=1)[:, None, None]
    else:
        counts = with_steady_light(counts, good)
    charge = counts.mean(axis=0) - bias
    if is_dark:
        # The noise of the dark charge of a pixel is as large as the charge and would bias the slope of the line.
        # Since variance is linear in charge, the mean charge of the ordinary pixels can be used instead.
        middle = np.median(charge[good])
        spread = 1.4826 * np.median(np.abs(charge[good] - middle))
        good &= np.abs(charge - middle) <= _OUTLIER_SIGMAS * max(spread, ROUNDING_VARIANCE)
        charge = np.full_like(charge, charge[good].mean())
    return _Samples(charge[good], counts.var(axis=0, ddof=1)[good], stack.shape[0] - 1)


def _fit_line(
    samples: list[_Samples], floor: tuple[float, float] = _UNKNOWN, slope: tuple[float, float] = _UNKNOWN
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Straight line of variance against charge by iteratively reweighted least squares.

    Returns (floor, slope) and their covariance (2, 2). ``floor`` and ``slope`` are prior values with their standard
    deviations. Sample variances are chi-square distributed with a standard deviation proportional to their
    expectation. The weights are computed from the fitted line; weights from the samples would bias the fit low.
    """
    prior_mean, prior_sigma = np.transpose([floor, slope])
    prior_weight = np.diag(prior_sigma**-2.0)
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
        normal = prior_weight + np.array([[weight.sum(), cross], [cross, np.sum(weight * charge**2)]])
        weighted_sums = np.array([np.sum(weight * variance), np.sum(weight * charge * variance)])
        line = np.linalg.solve(normal, weighted_sums + prior_weight @ prior_mean)
        keep = variance < _OUTLIER_SIGMAS**2 * np.maximum(line[0] + line[1] * charge, ROUNDING_VARIANCE)
    return line, np.asarray(np.linalg.inv(normal), np.float64)


def _phase_sigma(variance_dn2: float) -> float:
    """Standard deviation of the variance of rounded counts over the phases of a level, DN^2.

    Take noise of variance s about a level at x of the way to the next count. Once rounded it has the variance
    s + 1/12 - A cos(2 pi x), where A = (1/pi^2 + 4 s) exp(-2 pi^2 s) (Widrow and Kollar, Quantization Noise, 2008).
    All pixels of a dark may share x, which is unknown.
    """
    amplitude = (1 / np.pi**2 + 4 * variance_dn2) * np.exp(-2 * np.pi**2 * variance_dn2)
    return float(amplitude / np.sqrt(2))


def _read_noise(
    floor_dn2: float, gain: float, covariance: NDArray[np.float64], *, gain_is_fitted: bool
) -> tuple[float, float]:
    """Read noise and its standard deviation, e-, of a line with its covariance (2, 2).

    To first order, with the uncertainty by rounding. A gain that is the reciprocal slope errs with the floor.
    """
    read_dn = float(np.sqrt(max(floor_dn2, _ROUNDED_VARIANCE) - ROUNDING_VARIANCE))
    gradient = np.array([gain / (2 * read_dn), -read_dn * gain**2 if gain_is_fitted else 0.0])
    by_rounding = gain * _phase_sigma(read_dn**2) / (2 * read_dn)
    return read_dn * gain, float(np.hypot(np.sqrt(gradient @ covariance @ gradient), by_rounding))


def _light_notes(capture: Capture, dark: DarkLibrary) -> list[str]:
    """Notes on flats and references whose light changes between repeats."""
    notes = []
    for kind, tables in (("flat", capture.manifest.flats), ("reference", capture.manifest.reference)):
        for table in tables:
            if len(table.frames) < 2:
                continue
            stack = capture.frames(table)
            good = (stack.max(axis=0) < capture.saturation_dn) & (stack.min(axis=0) > 0)
            change = light_change(stack.astype(float), dark.at(table.exposure_s), good)
            if change >= LIGHT_CHANGE_NOTED:
                notes.append(
                    f"{table.band}: the light of the {kind} changes by {100 * change:.2g} % between repeats; for the "
                    "noise they are scaled to one mean"
                )
    return notes


def _different_flats(capture: Capture) -> tuple[FlatTable, ...]:
    """All flats; of a mosaic those of different frames, which may stand once for each channel.

    The noise comes from all pixels of a frame, so each frame counts once.
    """
    flats = capture.manifest.flats
    if capture.manifest.mosaic is None:
        return flats
    return tuple(flat for k, flat in enumerate(flats) if flat.frames not in [other.frames for other in flats[:k]])


def _samples_of_bands(capture: Capture, bias: NDArray[np.float64]) -> tuple[list[_Samples], NoiseSource]:
    """Samples of the bands' repeats, or else of neighbouring pixels."""
    tables: list[FrameTable] = [*capture.manifest.band, *capture.manifest.bracket]
    repeated = [table for table in tables if len(table.frames) > 1]
    of_repeats = [_samples(capture.frames(table), bias, capture.saturation_dn, is_dark=False) for table in repeated]
    of_repeats = [samples for samples in of_repeats if samples.charge.size]
    if of_repeats:
        return of_repeats, "band repeats"
    of_pictures = [samples for table in tables for samples in _samples_of_picture(capture, table, bias)]
    return of_pictures, "estimated" if of_pictures else "unknown"


def _samples_of_picture(capture: Capture, table: FrameTable, bias: NDArray[np.float64]) -> list[_Samples]:
    """Charge and variance of one frame by its neighbouring pixels, in levels of equally many."""
    frame = capture.frames(table)[0].astype(float)
    usable = (frame < capture.saturation_dn) & (frame > 0)
    step = capture.cell or (1, 1)
    differences, means = second_differences(frame - bias, usable, step)
    samples = []
    for level in np.array_split(np.argsort(means), _PICTURE_LEVELS):
        variance = clipped_variance(differences[level])
        if np.isfinite(variance):
            # differences of neighbours share pixels: a third as many are independent
            degrees = max(1, level.size // 3)
            samples.append(_Samples(means[level].mean(keepdims=True), np.array([variance]), degrees))
    return samples


def measure_noise(capture: Capture, dark: DarkLibrary) -> NoiseModel:
    """Gain and read noise from flats and darks, else from the manifest or the bands.

    A measured value replaces a stated one. A difference of more than five standard deviations is noted. Without flats
    and a stated gain the bands' repeats give it; without these the differences of neighbouring pixels, which are
    larger than the noise where the scene has texture.

    Parameters
    ----------
    capture
        The capture.
    dark
        Its dark levels; their bias is subtracted.

    Returns
    -------
    NoiseModel
        With notes on what could not be measured.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    camera, notes = capture.manifest.camera, []
    flats = [flat for flat in _different_flats(capture) if len(flat.frames) > 1]
    darks = [table for table in capture.manifest.darks if len(table.frames) > 1]
    gain, gain_sigma = camera.gain_e_per_dn, None
    read, read_sigma = camera.read_noise_e, None
    usable_darks = darks if not dark.clipped else []
    if dark.clipped:
        notes.append(
            "the dark frames are clipped at 0 DN: read noise and a negative offset cannot be measured from them"
        )
    bias, saturation = dark.bias, capture.saturation_dn
    bright_samples = [_samples(capture.frames(table), bias, saturation, is_dark=False) for table in flats]
    dark_samples = [_samples(capture.frames(table), bias, saturation, is_dark=True) for table in usable_darks]
    bright_samples, dark_samples = (
        [s for s in bright_samples if s.charge.size],
        [s for s in dark_samples if s.charge.size],
    )
    notes += _light_notes(capture, dark)
    source: NoiseSource = "flats" if bright_samples else "unknown" if gain is None else "stated"
    if source == "unknown":
        bright_samples, source = _samples_of_bands(capture, bias)
    quietest = min((float(s.variance.mean()) for s in dark_samples), default=np.inf)
    rounded = quietest < _ROUNDED_VARIANCE
    if not bright_samples:
        notes.append(f"gain not measured: {'the flats are saturated or copied' if flats else 'no flat with repeats'}")
    if source == "band repeats":
        notes.append("the noise comes from the repeats of the bands: no flat with repeats, and no gain is stated")
    if source == "estimated":
        notes.append("the noise is estimated from neighbouring pixels of the bands: no repeats, and no gain is stated")
    if not dark_samples:
        notes.append("read noise not measured: no usable dark frames with repeats")
    fitted_samples, floor, slope = [*bright_samples, *dark_samples], _UNKNOWN, _UNKNOWN
    if rounded:
        low, high = ROUNDING_VARIANCE, _ROUNDED_VARIANCE
        fitted_samples, floor = bright_samples, ((low + high) / 2, (high - low) / float(np.sqrt(12)))
    if not bright_samples and gain is not None:
        slope = 1 / gain, 1e-6 / gain
    one_level = bool(fitted_samples) and np.ptp(np.concatenate([s.charge for s in fitted_samples])) == 0
    if one_level and floor is _UNKNOWN and slope is _UNKNOWN:
        notes.append("gain and read noise not measured: all frames with repeats have one level")
    elif bright_samples or (fitted_samples and gain is not None):
        line, covariance = _fit_line(fitted_samples, floor, slope)
        if bright_samples:
            gain, gain_sigma = float(1 / line[1]), float(np.sqrt(covariance[1, 1]) / line[1] ** 2)
        if (dark_samples or source in _OF_BANDS) and not rounded and gain is not None:
            read, read_sigma = _read_noise(float(line[0]), gain, covariance, gain_is_fitted=bool(bright_samples))
    if rounded:
        largest = float(np.sqrt(_ROUNDED_VARIANCE - ROUNDING_VARIANCE))
        notes.append(f"rounding to whole counts hides the read noise: it lies between 0 and {largest:.1g} DN")
        if read is None and gain is not None:
            read = gain * float(np.sqrt(max(quietest - ROUNDING_VARIANCE, largest**2 / 4)))
            read_sigma = gain * largest / float(np.sqrt(12))
    for quantity, manifest_value, value, sigma in (
        ("gain", camera.gain_e_per_dn, gain, gain_sigma),
        ("read noise", camera.read_noise_e, read, read_sigma),
    ):
        if (
            manifest_value is not None
            and value is not None
            and sigma is not None
            and abs(manifest_value - value) > 5 * sigma
        ):
            notes.append(
                f"{quantity}: the manifest states {manifest_value:g}, the frames show {value:.4g} +- {sigma:.2g}"
            )
    if gain is None:
        notes.append("gain unknown: no variance includes shot noise or read noise")
    return NoiseModel(gain, gain_sigma, read, read_sigma, tuple(notes), source)
