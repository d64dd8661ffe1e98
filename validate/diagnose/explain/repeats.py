"""Frames of one band compared with each other, before any model.

An effect acts in every frame of a band. A lamp that flickers, a table that is pushed and a shutter that sticks act in
one frame, and their mean over the frames may look like an effect. The frames' differences say which it is: the
amplitude of the effect's own change in each frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray

from ..field_fit import Advice
from ..hypotheses import CERTAIN_SIGMA, INDISTINGUISHABLE_CHI2
from .rival_form import Lead

__all__ = ["FrameAmplitudes", "flicker_of", "frame_amplitudes", "lead_of_frames"]

#: Part of an amplitude by which frames may differ without an event: a drift goes on between two frames of a band.
_MAX_DIFFERENCE = 0.2

#: Part of the square of a change in a band from which it is a level of that band: no other pattern remains.
_LEVEL_PART = 0.98

#: The same in amplitudes of the effect: a half of it may be missing in one frame.
_MIN_DIFFERENCE = 0.5


@dataclass(frozen=True, eq=False)
class FrameAmplitudes:
    """Amplitude of a change in each frame of a band; the mean of all frames of a band is 1."""

    #: Name of the band.
    band: str
    #: (frame,) amplitudes.
    amplitude: NDArray[np.float64]
    #: (frame,) their standard deviations.
    sigma: NDArray[np.float64]

    @property
    def differ(self) -> bool:
        """Whether two frames differ by more than noise, and by a large part of the change."""
        differences = self.amplitude[:, None] - self.amplitude
        sigma = np.hypot(self.sigma[:, None], self.sigma)
        return bool(np.any((differences > CERTAIN_SIGMA * sigma) & (differences > _MIN_DIFFERENCE)))

    def chi2_from(self, common: float) -> NDArray[np.float64]:
        """Chi2 by which each frame differs from a common amplitude, at most that of an event.

        Parameters
        ----------
        common
            Amplitude that all frames have in common.

        Returns
        -------
        NDArray
            (frame,) chi2.
        """
        square = (self.amplitude - common) ** 2 / (self.sigma**2 + _MAX_DIFFERENCE**2)
        return np.minimum(square, INDISTINGUISHABLE_CHI2)


def flicker_of(levels: NDArray[np.float64]) -> float:
    """Relative scatter of the levels of frames in most bands.

    Parameters
    ----------
    levels
        (band, frame) relative levels less their band's mean; NaN where there is no frame.

    Returns
    -------
    float
        Standard deviation by the median, which an event in one band does not change; 0 without repeats.
    """
    several = levels[np.isfinite(levels)]
    return robust_sigma(several) if several.size else 0.0


def frame_amplitudes(
    band: str,
    frames: NDArray[np.floating],
    change: NDArray[np.float64],
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
    flicker: float,
) -> FrameAmplitudes:
    """Amplitude of a change in each frame of a band.

    Each frame less the mean of all is fitted by the change and by a level, since lamps flicker. A change
    that is a level itself is fitted alone, and the flicker counts as an error of its amplitude.

    Parameters
    ----------
    band
        Name of the band.
    frames
        (frame, y, x) signal of each frame, DN.
    change
        (y, x) change of the mean of all frames, DN.
    signal
        (y, x) signal without it, DN.
    weight
        (y, x) 1 / sigma of a sample, 1/DN; 0 where unused.
    flicker
        Standard deviation of the levels of frames, relative.

    Returns
    -------
    FrameAmplitudes
        With standard deviations by the scatter of what remains; infinite where nothing changes.
    """
    pattern, level = (change * weight).ravel(), (signal * weight).ravel()
    size = max(float(level @ level), 1e-300)
    along = float(pattern @ level) / size
    is_level = (along * along * size) > _LEVEL_PART * float(pattern @ pattern)
    differences = ((frames - frames.mean(axis=0)) * weight).reshape(len(frames), -1)
    if not is_level:
        pattern = pattern - along * level
        differences = differences - np.outer(differences @ level / size, level)
    power = float(pattern @ pattern)
    if not power > 0:
        return FrameAmplitudes(band, np.ones(len(frames)), np.full(len(frames), np.inf))
    parts = differences @ pattern / power
    rest = differences - np.outer(parts, pattern)
    variance = np.sum((rest * pattern) ** 2, axis=1) / power**2
    of_flicker = flicker / max(abs(along), 1e-300) if is_level else 0.0
    return FrameAmplitudes(band, 1 + parts, np.sqrt(variance + of_flicker**2))


def lead_of_frames(each: Sequence[FrameAmplitudes], price: float) -> Lead | None:
    """Lead of events in single frames over an effect that acts in all of them.

    With an effect, frames differ from one amplitude by events. Without it they differ from 0 by events, and there are
    no numbers to be paid. Where one frame of a band has all of the change, one event stands against an effect and an
    event that cancels it, to within the errors by chance.

    Parameters
    ----------
    each
        Amplitudes of the effect's change in the frames of every band, see `frame_amplitudes`.
    price
        Chi2 that the effect's numbers must gain.

    Returns
    -------
    Lead or None
        None where frames of a band do not differ by much of the effect.
    """
    differing = [band for band in each if band.differ]
    if not differing:
        return None
    amplitudes = np.concatenate([band.amplitude for band in each])
    common = [1.0, *amplitudes[np.abs(amplitudes) > _MIN_DIFFERENCE]]
    with_effect = min(sum(float(band.chi2_from(a).sum()) for band in each) for a in common)
    by_events = sum(float(band.chi2_from(0.0).sum()) for band in each)
    if any((np.abs(band.amplitude) < _MAX_DIFFERENCE).any() for band in differing):
        price -= 2 * np.log(_MAX_DIFFERENCE)
    most = max(differing, key=lambda band: float(np.ptp(band.amplitude)))
    frame = int(np.argmax(np.abs(most.amplitude))) + 1
    form = f"frame {frame} of {len(most.amplitude)} of band {most.band}"
    return Lead(float(with_effect + price - by_events), "an event while a single frame was taken", form, _advice(most))


def _advice(band: FrameAmplitudes) -> Advice:
    return Advice(
        "",
        "in time: frames of one band differ",
        ("a lamp that flickered", "a shutter that stuck", "a table that was pushed, a door that opened"),
        f"Photograph band {band.band} again with at least three frames: what all of them show is no event.",
    )
