"""Checks of dark frames against each other: level and hot pixels increase with exposure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..correction import NoiseModel
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_darks"]

#: Deviation of a frame from the trend, in standard deviations of noise.
_SIGMAS = 7.0
#: Smallest deviation of a level that is reported; with only two exposures, smallest decrease.
_SMALLEST_DN, _LIGHT_DN = 0.12, 1.0
#: The same as a share of the thermal charge, whose spread over the pixels makes the level bend by some tenths of it.
_SMALLEST_SHARE = 0.005


@dataclass(frozen=True, eq=False)
class _Dark:
    stack: Stack
    repeat: int
    frame: NDArray[np.float64]


def _frames(stacks: Sequence[Stack]) -> list[_Dark]:
    return [
        _Dark(stack, repeat, frame.astype(float))
        for stack in stacks
        if stack.kind == "dark"
        for repeat, frame in enumerate(stack.whole)
    ]


def _robust_line(time: NDArray[np.float64], level: NDArray[np.float64]) -> tuple[float, float]:
    """Slope: weighted median of the slopes of all pairs (Theil 1950, Sen 1968); intercept: median of the residuals."""
    i, j = np.triu_indices(time.size, 1)
    apart = np.abs(time[j] - time[i]) > 1e-9
    slopes = (level[j] - level[i])[apart] / (time[j] - time[i])[apart]
    weights = np.abs(time[j] - time[i])[apart]
    order = np.argsort(slopes)
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    slope = float(slopes[order][half])
    return slope, float(np.median(level - slope * time))


def check_darks(stacks: Sequence[Stack], noise: NoiseModel, full_scale: int) -> Iterator[Suspicion]:
    """Detects dark frames of another exposure, with light in them, or of another state of the sensor."""
    darks = _frames(stacks)
    if not darks:
        return
    variance = noise.floor_dn2
    time = np.array([dark.stack.exposure_s for dark in darks])
    level = np.array([_level(dark.frame) for dark in darks])
    yield from _levels(darks, time, level, variance)
    yield from _charge(darks, time, variance, full_scale)


def _level(frame: NDArray[np.float64]) -> float:
    """Mean of the ordinary counts; the median is an integer."""
    middle = np.median(frame)
    near = np.abs(frame - middle) <= 6 * max(1.4826 * np.median(np.abs(frame - middle)), 1.0)
    return float(frame[near].mean())


def _levels(
    darks: Sequence[_Dark], time: NDArray[np.float64], level: NDArray[np.float64], variance: float
) -> Iterator[Suspicion]:
    """Detects levels that deviate from a straight line over exposure."""
    exposures = np.unique(time)
    if exposures.size < 3:
        if exposures.size == 2:
            short, long = (float(level[time == e].mean()) for e in exposures)
            if short - long > max(_LIGHT_DN, 0.02 * abs(long)):
                yield Suspicion(
                    "dark frames of another exposure, or with light in them",
                    f"{darks[0].stack.key}.frames",
                    f"Those of {exposures[0]:g} s have {short:.2f} DN, those of {exposures[1]:g} s only {long:.2f} DN.",
                )
        return
    slope, start = _robust_line(time, level)
    off = level - start - slope * time
    usual = 1.4826 * float(np.median(np.abs(off)))
    sigma = max(usual, float(np.sqrt(variance / darks[0].frame.size)))
    allowed = np.maximum(_SIGMAS * sigma, np.maximum(_SMALLEST_DN, _SMALLEST_SHARE * np.abs(slope) * time))
    flagged = set()
    for dark, left, most in sorted(zip(darks, off, allowed, strict=True), key=lambda row: -abs(row[1])):
        if abs(left) > most and dark.stack.key not in flagged:
            flagged.add(dark.stack.key)
            expected = start + slope * dark.stack.exposure_s
            what = "with light in them, or of another exposure" if left > 0 else "of another exposure"
            yield Suspicion(
                f"dark frames {what}",
                dark.stack.paths[dark.repeat],
                f"Its level is {expected + left:.2f} DN; the trend over the exposures gives {expected:.2f} DN at "
                f"{dark.stack.exposure_s:g} s.",
            )


def _charge(darks: Sequence[_Dark], time: NDArray[np.float64], variance: float, full_scale: int) -> Iterator[Suspicion]:
    """Detects hot pixels whose charge does not increase with exposure; only the order is tested."""
    frames = np.stack([dark.frame - _level(dark.frame) for dark in darks])
    sigma = np.sqrt(variance)
    # Hot in more frames than one table has, to exclude light or cosmic rays in one table.
    repeats = max(len(dark.stack.paths) for dark in darks)
    if len(darks) <= repeats + 1:
        return
    hot = np.sort(frames, axis=0)[-repeats - 1] > 8 * sigma
    hot &= np.stack([dark.frame for dark in darks]).max(axis=0) < 0.9 * full_scale
    count = int(np.count_nonzero(hot))
    if count < 3:
        return
    charge = frames[:, hot].mean(axis=1)
    noise = np.sqrt(2 * (variance + np.maximum(charge, 0) / 2) / count) + 0.02 * np.abs(charge)
    left = np.ones(len(darks), bool)
    flagged: set[str] = set()
    for _ in darks:
        wrong = np.zeros(len(darks))
        for k in np.flatnonzero(left):
            longer, shorter = left & (time > 1.3 * time[k]), left & (time < time[k] / 1.3)
            apart = _SIGMAS * np.hypot(noise[k], noise)
            wrong[k] = np.sum(longer & (charge[k] - charge > apart)) + np.sum(shorter & (charge - charge[k] > apart))
        worst = int(np.argmax(wrong))
        if wrong[worst] == 0:
            break
        left[worst] = False
        dark = darks[worst]
        near = int(np.argmin(np.where(left, np.abs(charge - charge[worst]), np.inf)))
        if dark.stack.key not in flagged:
            flagged.add(dark.stack.key)
            yield Suspicion(
                "dark frames of another exposure",
                dark.stack.paths[dark.repeat],
                f"Its {count} hot pixels hold {charge[worst]:.3g} DN on average, as those of {time[near]:g} s; stated "
                f"are {dark.stack.exposure_s:g} s.",
            )
