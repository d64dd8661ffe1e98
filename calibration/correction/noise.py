"""Noise of a count by photon transfer: gain and read noise from differences between repeats.

With x the count above bias (light and thermal charge), the variance of one count is

    var = x / gain + (read_noise / gain)^2 + 1/12    [DN^2]

where 1/12 is due to rounding to whole counts (Janesick, Photon Transfer, SPIE 2007). Fixed patterns cancel in the
differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..capture import BandTable, BracketTable, Capture, FlatTable, FrameTable, ReferenceTable
from .dark import DarkLibrary
from .noise_line import (
    ROUNDED_VARIANCE,
    ROUNDING_VARIANCE,
    UNKNOWN,
    VarianceSamples,
    fit_noise_line,
    samples_of_repeats,
)
from .picture_noise import clipped_variance, second_differences, steps_of_cells
from .repeat_light import LIGHT_CHANGE_NOTED, WARM_UP_REPEATS, light_change

__all__ = ["ROUNDING_VARIANCE", "NoiseModel", "measure_noise"]

#: A kind of table of frames.
_Table = TypeVar("_Table", bound=FrameTable)
#: Harmonics of the rounding error that are summed: without noise the rest is 1e-4 of its square.
_HARMONICS = 1000
#: Where the shot noise of a count comes from: repeats of flats, the manifest, repeats of the bands, neighbouring pixels
#: of the bands, or nowhere.
NoiseSource = Literal["flats", "stated", "band repeats", "estimated", "unknown"]

#: Levels of light in a picture whose noise is taken from neighbours.
_PICTURE_LEVELS = 12
#: Standard deviations by which the gains of flats and of the scene may differ: chance exceeds it once in 370 captures.
_AGREEMENT_SIGMAS = 3.0
#: Standard deviations of a noted difference.
_NOTED_SIGMAS = 5.0
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
    #: Variances of ``floor_dn2`` (DN^4) and ``shot_dn`` (DN^2) and their covariance (DN^3); None if both are stated.
    line_covariance: tuple[float, float, float] | None = None

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

    def relative_sigma(self, floor_share: float, shot_share: float) -> float:
        """Relative error that many variances have in common, since gain and read noise are measured.

        Parameters
        ----------
        floor_share
            Mean share of the variances that is proportional to ``floor_dn2``, 0 to 1.
        shot_share
            Mean share of the variances that is proportional to ``shot_dn``, 0 to 1.

        Returns
        -------
        float
            Standard deviation of the mean of measured over true variances; 0 if gain and read noise are stated.
        """
        if self.line_covariance is None or self.shot_dn == 0:
            return 0.0
        of_floor, of_shot, of_both = self.line_covariance
        floor, shot = floor_share / self.floor_dn2, shot_share / self.shot_dn
        return float(np.sqrt(max(floor**2 * of_floor + shot**2 * of_shot + 2 * floor * shot * of_both, 0.0)))

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
    read_dn = float(np.sqrt(max(floor_dn2, ROUNDED_VARIANCE) - ROUNDING_VARIANCE))
    gradient = np.array([gain / (2 * read_dn), -read_dn * gain**2 if gain_is_fitted else 0.0])
    by_rounding = gain * _phase_sigma(read_dn**2) / (2 * read_dn)
    return read_dn * gain, float(np.hypot(np.sqrt(gradient @ covariance @ gradient), by_rounding))


def _light_notes(capture: Capture, dark: DarkLibrary) -> list[str]:
    """Notes on frames whose light changes between repeats."""
    manifest, notes = capture.manifest, []
    kinds: tuple[tuple[str, Sequence[BandTable | BracketTable | FlatTable | ReferenceTable]], ...] = (
        ("scene", (*manifest.band, *manifest.bracket)),
        ("flat", manifest.flats),
        ("reference", manifest.reference),
    )
    further = 0
    for kind, tables in kinds:
        for table in _of_different_frames(tables):
            stack = capture.frames(table)
            further += len(stack) - 1 if kind == "scene" else 0
            good = (stack.max(axis=0) < capture.saturation_dn) & (stack.min(axis=0) > 0)
            level = None if kind == "scene" else dark.at(table.exposure_s)
            change = light_change(stack.astype(float), level, good)
            if change < LIGHT_CHANGE_NOTED:
                continue
            of_frames = [other for other in tables if other.frames == table.frames]
            bands = ", ".join(other.id if isinstance(other, BandTable) else other.band for other in of_frames)
            exposure = f" at {table.exposure_s:g} s" if kind == "scene" and not isinstance(table, BandTable) else ""
            averaged = "averaged for the signal, and " if kind == "scene" else ""
            notes.append(
                f"{bands}: the light of the {kind}{exposure} changes by {100 * change:.2g} % between repeats; they "
                f"are {averaged}scaled to one mean for the noise"
            )
        if kind == "scene" and notes and further < WARM_UP_REPEATS:
            notes.append(
                f"a lamp that warms up and one that trembles look alike in {further} further "
                f"repeat{'s' * (further > 1)}: take {WARM_UP_REPEATS} or more, of all bands together"
            )
    return notes


def _of_different_frames(tables: Sequence[_Table]) -> list[_Table]:
    """Tables with repeats, without those of the frames of another one.

    Behind a mosaic a frame may stand once for each channel. The noise comes from all its pixels, so it counts once.
    """
    repeated = [table for table in tables if len(table.frames) > 1]
    return [table for k, table in enumerate(repeated) if table.frames not in [other.frames for other in repeated[:k]]]


def _samples_of_scene(
    capture: Capture,
    bias: NDArray[np.float64],
    of_flats: list[VarianceSamples],
    of_darks: list[VarianceSamples],
    floor: tuple[float, float],
) -> tuple[list[VarianceSamples], list[str]]:
    """Samples of references, bands and brackets that agree with those of the flats; notes.

    The difference of two repeats is independent of their mean, which is compared with a model. Motion and flicker make
    repeats of a scene differ by more than noise, and processing by less: then the flats alone count.
    """
    manifest = capture.manifest
    line, covariance = fit_noise_line([*of_flats, *of_darks], floor)
    everything: list[FrameTable] = [*manifest.reference, *manifest.band, *manifest.bracket]
    tables = _of_different_frames(everything)
    samples = [samples_of_repeats(capture.frames(table), bias, capture.saturation_dn, line=line) for table in tables]
    samples = [each for each in samples if each.charge.size]
    if not samples:
        return [], []
    scene_line, scene_covariance = fit_noise_line([*samples, *of_darks], floor)
    difference = float(abs(scene_line[1] - line[1]) / np.sqrt(covariance[1, 1] + scene_covariance[1, 1]))
    if difference <= _AGREEMENT_SIGMAS:
        return samples, []
    if difference <= _NOTED_SIGMAS:
        return [], []
    ratio = float(scene_line[1] / line[1])
    return [], [
        f"gain: references and bands vary between repeats by {ratio:.3g} times the variance of the flats, which alone "
        "were used"
    ]


def _samples_of_bands(capture: Capture, bias: NDArray[np.float64]) -> tuple[list[VarianceSamples], NoiseSource]:
    """Samples of the bands' repeats, or else of neighbouring pixels."""
    tables: list[FrameTable] = [*capture.manifest.band, *capture.manifest.bracket]
    repeated = _of_different_frames(tables)
    of_repeats = [samples_of_repeats(capture.frames(table), bias, capture.saturation_dn) for table in repeated]
    of_repeats = [samples for samples in of_repeats if samples.charge.size]
    if of_repeats:
        return of_repeats, "band repeats"
    of_pictures = [samples for table in tables for samples in _samples_of_picture(capture, table, bias)]
    return of_pictures, "estimated" if of_pictures else "unknown"


def _samples_of_picture(capture: Capture, table: FrameTable, bias: NDArray[np.float64]) -> list[VarianceSamples]:
    """Charge and variance of one frame by its neighbouring pixels, in levels of equally many."""
    frame = capture.frames(table)[0].astype(float)
    usable = (frame < capture.saturation_dn) & (frame > 0)
    differences, means = second_differences(frame - bias, usable, steps_of_cells(capture.cell))
    samples = []
    for level in np.array_split(np.argsort(means), _PICTURE_LEVELS):
        variance = clipped_variance(differences[level])
        if np.isfinite(variance):
            # differences of neighbours share pixels: a third as many are independent
            degrees = max(1, level.size // 3)
            samples.append(VarianceSamples(means[level].mean(keepdims=True), np.array([variance]), degrees))
    return samples


def _source_notes(
    bright_samples: list[VarianceSamples], dark_samples: list[VarianceSamples], source: NoiseSource, *, has_flats: bool
) -> list[str]:
    """Notes on what was not measured, and on noise that comes from the bands."""
    notes = []
    if not bright_samples:
        notes.append(
            f"gain not measured: {'the flats are saturated or copied' if has_flats else 'no flat with repeats'}"
        )
    if source == "band repeats":
        notes.append("the noise comes from the repeats of the bands: no flat with repeats, and no gain is stated")
    if source == "estimated":
        notes.append("the noise is estimated from neighbouring pixels of the bands: no repeats, and no gain is stated")
    if not dark_samples:
        notes.append("read noise not measured: no usable dark frames with repeats")
    return notes


def _contradictions(quantity: str, nominal: float | None, measured: float | None, sigma: float | None) -> list[str]:
    """Note on a stated value that the frames contradict; empty without one."""
    if nominal is None or measured is None or sigma is None or not abs(nominal - measured) > _NOTED_SIGMAS * sigma:
        return []
    return [f"{quantity}: the manifest states {nominal:g}, the frames show {measured:.4g} +- {sigma:.2g}"]


def measure_noise(capture: Capture, dark: DarkLibrary) -> NoiseModel:
    """Gain and read noise from flats, darks and the scene, else from the manifest or the bands.

    The repeats of flats, references, bands and brackets give one line with the darks, where they agree. A measured
    value replaces a stated one. A difference of more than five standard deviations is noted. Without flats
    and a stated gain the bands' repeats give it; without these the differences of neighbouring pixels, which are
    larger than the noise where the scene has texture.

    Parameters
    ----------
    capture
        The capture.
    dark
        The capture's dark levels; their bias is subtracted.

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
    flats = _of_different_frames(capture.manifest.flats)
    darks = [table for table in capture.manifest.darks if len(table.frames) > 1]
    gain, gain_sigma = camera.gain_e_per_dn, None
    read, read_sigma = camera.read_noise_e, None
    line_covariance = None
    usable_darks = darks if not dark.clipped else []
    if dark.clipped:
        notes.append(
            "the dark frames are clipped at 0 DN: read noise and a negative offset cannot be measured from them"
        )
    bias, saturation = dark.bias, capture.saturation_dn
    bright_samples = [samples_of_repeats(capture.frames(table), bias, saturation) for table in flats]
    dark_samples = [samples_of_repeats(capture.frames(table), bias, saturation, is_dark=True) for table in usable_darks]
    bright_samples, dark_samples = (
        [s for s in bright_samples if s.charge.size],
        [s for s in dark_samples if s.charge.size],
    )
    notes += _light_notes(capture, dark)
    source: NoiseSource = "flats" if bright_samples else "unknown" if gain is None else "stated"
    if source == "unknown":
        bright_samples, source = _samples_of_bands(capture, bias)
    quietest = min((float(s.variance.mean()) for s in dark_samples), default=np.inf)
    rounded = quietest < ROUNDED_VARIANCE
    notes += _source_notes(bright_samples, dark_samples, source, has_flats=bool(flats))
    fitted_samples, floor, slope = [*bright_samples, *dark_samples], UNKNOWN, UNKNOWN
    if rounded:
        low, high = ROUNDING_VARIANCE, ROUNDED_VARIANCE
        fitted_samples, floor = bright_samples, ((low + high) / 2, (high - low) / float(np.sqrt(12)))
    if not bright_samples and gain is not None:
        slope = 1 / gain, 1e-6 / gain
    one_level = bool(fitted_samples) and np.ptp(np.concatenate([s.charge for s in fitted_samples])) == 0
    if one_level and floor is UNKNOWN and slope is UNKNOWN:
        notes.append("gain and read noise not measured: all frames with repeats have one level")
    elif bright_samples or (fitted_samples and gain is not None):
        if source == "flats":
            of_scene, scene_notes = _samples_of_scene(
                capture, bias, bright_samples, [] if rounded else dark_samples, floor
            )
            fitted_samples, notes = [*fitted_samples, *of_scene], [*notes, *scene_notes]
        line, covariance = fit_noise_line(fitted_samples, floor, slope)
        line_covariance = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
        if bright_samples:
            gain, gain_sigma = float(1 / line[1]), float(np.sqrt(covariance[1, 1]) / line[1] ** 2)
        if (dark_samples or source in _OF_BANDS) and not rounded and gain is not None:
            read, read_sigma = _read_noise(float(line[0]), gain, covariance, gain_is_fitted=bool(bright_samples))
    if rounded:
        largest = float(np.sqrt(ROUNDED_VARIANCE - ROUNDING_VARIANCE))
        notes.append(f"rounding to whole counts hides the read noise: it lies between 0 and {largest:.1g} DN")
        if read is None and gain is not None:
            read = gain * float(np.sqrt(max(quietest - ROUNDING_VARIANCE, largest**2 / 4)))
            read_sigma = gain * largest / float(np.sqrt(12))
    notes += _contradictions("gain", camera.gain_e_per_dn, gain, gain_sigma)
    notes += _contradictions("read noise", camera.read_noise_e, read, read_sigma)
    if gain is None:
        notes.append("gain unknown: no variance includes shot noise or read noise")
    return NoiseModel(gain, gain_sigma, read, read_sigma, tuple(notes), source, line_covariance=line_covariance)
