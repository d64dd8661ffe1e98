"""Checks of dark frames against each other: level and hot pixels increase with exposure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import robust_sigma, student_tail
from numpy.typing import NDArray

from ...correction import NoiseModel
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_bias_drift", "check_darks"]

#: Suspicious deviation of a frame from the trend, in standard deviations of noise.
LARGEST_SIGMAS = 7.0

#: Smallest suspicious deviation of a level, DN: less than the rounding of a count.
SMALLEST_DEVIATION_DN = 0.12

#: The same over the thermal charge, whose spread over the pixels makes the level bend by some tenths of it.
SMALLEST_DEVIATION_SHARE = 0.005

#: Smallest suspicious decrease of the level with only two exposures, DN.
SMALLEST_DECREASE_DN = 1.0

#: The same over the level.
SMALLEST_DECREASE_SHARE = 0.02

#: Counts farther than this many robust standard deviations from the median do not count for a level.
ORDINARY_SIGMAS = 6

#: Smallest charge of a hot pixel, in standard deviations of reading.
HOT_SIGMAS = 8

#: Largest count of a hot pixel over full scale: beyond, its charge does not increase any more.
HOT_SATURATION = 0.9

#: Fewest hot pixels whose charge is compared.
FEWEST_HOT_PIXELS = 3

#: Factor between two exposures from which on the order of their charges is certain.
EXPOSURE_FACTOR = 1.3

#: Relative standard deviation of the charge from frame to frame, in addition to noise.
CHARGE_SCATTER = 0.02


#: Probability with which trembling levels pass for a drift; the noise of steady ones does not change them enough.
DRIFT_FALSE_ALARM = 5e-4

#: Smallest drift over the dark frames that is named, DN: less moves no dark level by more than its rounding.
SMALLEST_DRIFT_DN = 0.2

#: Fewest degrees of freedom of the scatter of the frames about the drift: three tables of two frames.
FEWEST_DRIFT_DEGREES = 2


@dataclass(frozen=True, eq=False)
class _Dark:
    """One dark frame."""

    #: Its table.
    stack: Stack
    #: Its index in the table.
    repeat: int
    #: (y, x) DN.
    frame: NDArray[np.float64]


def check_darks(stacks: Sequence[Stack], noise: NoiseModel, full_scale: int) -> Iterator[Suspicion]:
    """Detect dark frames of another exposure, with light, or of another state of the sensor.

    Parameters
    ----------
    stacks
        All frames.
    noise
        Noise of reading.
    full_scale
        Saturation, DN.

    Yields
    ------
    Suspicion
        For each table whose level deviates from the trend over the exposures, then for each whose hot pixels do.
    """
    darks = [
        _Dark(stack, repeat, frame.astype(float))
        for stack in stacks
        if stack.kind == "dark"
        for repeat, frame in enumerate(stack.frames)
    ]
    if not darks:
        return
    variance = noise.floor_dn2
    time = np.array([dark.stack.exposure_s for dark in darks])
    level = np.array([_level(dark.frame) for dark in darks])
    if np.unique(time).size < 3:
        yield from _check_decrease(darks, time, level)
    else:
        yield from _check_trend(darks, time, level, variance)
    yield from _check_hot_pixels(darks, time, variance, full_scale)


def _level(frame: NDArray[np.float64]) -> float:
    """Mean of the ordinary counts, DN; the median is an integer."""
    middle = np.median(frame)
    deviation = np.abs(frame - middle)
    near = deviation <= ORDINARY_SIGMAS * max(robust_sigma(deviation), 1.0)
    return float(frame[near].mean())


def _check_decrease(
    darks: Sequence[_Dark], time: NDArray[np.float64], level: NDArray[np.float64]
) -> Iterator[Suspicion]:
    """Levels of two exposures: the longer one must not be darker."""
    exposures = np.unique(time)
    if exposures.size != 2:
        return
    short, long = (float(level[time == e].mean()) for e in exposures)
    if short - long > max(SMALLEST_DECREASE_DN, SMALLEST_DECREASE_SHARE * abs(long)):
        yield Suspicion(
            "dark frames of another exposure, or with light in them",
            f"{darks[0].stack.key}.frames",
            f"Those of {exposures[0]:g} s have {short:.2f} DN, those of {exposures[1]:g} s only {long:.2f} DN.",
        )


def _check_trend(
    darks: Sequence[_Dark], time: NDArray[np.float64], level: NDArray[np.float64], variance: float
) -> Iterator[Suspicion]:
    """Levels that deviate from a straight line over the exposures, the farthest first."""
    slope, start = _robust_line(time, level)
    deviation = level - start - slope * time
    usual = robust_sigma(deviation)
    sigma = max(usual, float(np.sqrt(variance / darks[0].frame.size)))
    smallest = np.maximum(SMALLEST_DEVIATION_DN, SMALLEST_DEVIATION_SHARE * np.abs(slope) * time)
    allowed = np.maximum(LARGEST_SIGMAS * sigma, smallest)
    flagged = set()
    for dark, excess, most in sorted(zip(darks, deviation, allowed, strict=True), key=lambda row: -abs(row[1])):
        if abs(excess) > most and dark.stack.key not in flagged:
            flagged.add(dark.stack.key)
            expected = start + slope * dark.stack.exposure_s
            what = "with light in them, or of another exposure" if excess > 0 else "of another exposure"
            yield Suspicion(
                f"dark frames {what}",
                dark.stack.paths[dark.repeat],
                f"Its level is {expected + excess:.2f} DN; the trend over the exposures gives {expected:.2f} DN at "
                f"{dark.stack.exposure_s:g} s.",
            )


def _robust_line(time: NDArray[np.float64], level: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and intercept of levels over time.

    Slope: weighted median of the slopes of all pairs (Theil 1950, Sen 1968); intercept: median of the residuals.
    """
    i, j = np.triu_indices(time.size, 1)
    apart = np.abs(time[j] - time[i]) > 1e-9
    slopes = (level[j] - level[i])[apart] / (time[j] - time[i])[apart]
    weights = np.abs(time[j] - time[i])[apart]
    order = np.argsort(slopes)
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    slope = float(slopes[order][half])
    return slope, float(np.median(level - slope * time))


def _check_hot_pixels(
    darks: Sequence[_Dark], time: NDArray[np.float64], variance: float, full_scale: int
) -> Iterator[Suspicion]:
    """Hot pixels whose charge does not increase with exposure; only the order is tested.

    The frame that contradicts most others is taken out, until no contradiction is left.
    """
    frames = np.stack([dark.frame - _level(dark.frame) for dark in darks])
    sigma = np.sqrt(variance)
    # Hot in more frames than one table has, to exclude light or cosmic rays in one table.
    repeats = max(len(dark.stack.paths) for dark in darks)
    if len(darks) <= repeats + 1:
        return
    hot = np.sort(frames, axis=0)[-repeats - 1] > HOT_SIGMAS * sigma
    hot &= np.stack([dark.frame for dark in darks]).max(axis=0) < HOT_SATURATION * full_scale
    count = int(np.count_nonzero(hot))
    if count < FEWEST_HOT_PIXELS:
        return
    charge = frames[:, hot].mean(axis=1)
    noise = np.sqrt(2 * (variance + np.maximum(charge, 0) / 2) / count) + CHARGE_SCATTER * np.abs(charge)
    consistent = np.ones(len(darks), bool)
    flagged: set[str] = set()
    for _ in darks:
        wrong = _contradictions(time, charge, noise, consistent)
        worst = int(np.argmax(wrong))
        if wrong[worst] == 0:
            break
        consistent[worst] = False
        dark = darks[worst]
        near = int(np.argmin(np.where(consistent, np.abs(charge - charge[worst]), np.inf)))
        if dark.stack.key not in flagged:
            flagged.add(dark.stack.key)
            yield Suspicion(
                "dark frames of another exposure",
                dark.stack.paths[dark.repeat],
                f"Its {count} hot pixels hold {charge[worst]:.3g} DN on average, as those of {time[near]:g} s; stated "
                f"are {dark.stack.exposure_s:g} s.",
            )


def _contradictions(
    time: NDArray[np.float64], charge: NDArray[np.float64], noise: NDArray[np.float64], usable: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(n,) number of usable frames that contradict each usable frame.

    Such a frame is longer and less charged, or shorter and more charged.
    """
    wrong = np.zeros(len(time))
    for k in np.flatnonzero(usable):
        longer, shorter = usable & (time > EXPOSURE_FACTOR * time[k]), usable & (time < time[k] / EXPOSURE_FACTOR)
        apart = LARGEST_SIGMAS * np.hypot(noise[k], noise)
        wrong[k] = np.sum(longer & (charge[k] - charge > apart)) + np.sum(shorter & (charge - charge[k] > apart))
    return wrong


def check_bias_drift(stacks: Sequence[Stack], readout_s: float) -> Iterator[Suspicion]:
    """Detect dark levels that rise or fall from frame to frame.

    A table of one exposure has one level. Its frames follow each other by the exposure and the readout, so that their
    levels about their mean show the drift alone.

    Parameters
    ----------
    stacks
        All frames.
    readout_s
        Time between the end of a frame and the start of the next, s.

    Yields
    ------
    Suspicion
        At most one.
    """
    darks = [stack for stack in stacks if stack.kind == "dark" and len(stack.frames) > 1]
    if not darks:
        return
    times = [np.arange(len(stack.frames)) * (stack.exposure_s + readout_s) for stack in darks]
    levels = [np.array([_level(frame) for frame in stack.frames]) for stack in darks]
    time = np.concatenate([each - each.mean() for each in times])
    level = np.concatenate([each - each.mean() for each in levels])
    degrees = time.size - len(darks) - 1
    if degrees < FEWEST_DRIFT_DEGREES:
        return
    lever = float(time @ time)
    slope = float(time @ level) / lever
    scatter = float(np.sum((level - slope * time) ** 2)) / degrees
    pull = abs(slope) / np.sqrt(scatter / lever) if scatter > 0 else 0.0
    span = max(float(np.ptp(each)) for each in times)
    if 2 * student_tail(pull, degrees) < DRIFT_FALSE_ALARM and abs(slope) * span > SMALLEST_DRIFT_DN:
        yield Suspicion(
            "the bias drifts from frame to frame (a sensor that warms up or cools down)",
            "dark.frames",
            f"The level of the dark frames changes by {60 * slope:+.2g} +- {60 * np.sqrt(scatter / lever):.1g} DN a "
            f"minute, {slope * span:+.2g} DN within one table. Frames taken at other times have another dark level.",
        )
