"""Checks of the counts: saturation, gaps, and levels relative to full scale and dark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ..capture import Capture
from ..correction import DarkLibrary, NoiseModel
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_counts", "check_level_of_darks"]

#: Fewest pixels at the largest count of a table that are a saturation.
FEWEST_PILED_PIXELS = 12

#: Smallest ratio of the pixels at the largest count to the mean of the counts below it.
PILE_RATIO = 12.0

#: Number of counts below the largest one that it is compared with.
PILE_NEIGHBOURS = 20

#: Smallest ratio of the number of different counts to that expected from a smooth histogram.
SMALLEST_CODE_SHARE = 0.6

#: Fewest counts of a histogram in which gaps can be detected.
FEWEST_CODES = 25

#: Window by which a histogram is smoothed, DN.
SMOOTHING_DN = 65

#: Largest share of saturated pixels by kind of frame: photographs show the lamp, fields are even.
LARGEST_SATURATED_SHARE = {"band": 0.3, "flat": 0.1, "reference": 0.1}

#: Frames show no light if their bright pixels exceed the dark level by less than this many standard deviations.
NO_LIGHT_SIGMAS = 3

#: The same, in addition, as a share of the dark level.
NO_LIGHT_SHARE = 0.02

#: Dark level over the standard deviation of reading, below which frames cannot be darker than it.
LOWEST_LEVEL_SIGMAS = 10

#: Frames are darker than the dark frames if their dark pixels lack this share of the dark level.
DARKER_SHARE = 0.5


def check_counts(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Check saturation, gaps between counts, and levels relative to full scale and dark.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's noise of reading.

    Yields
    ------
    Suspicion
        One for a saturation, one for gaps, one for each table without light or with too much of it.
    """
    yield from _check_codes(capture, stacks)
    yield from _check_levels(capture, stacks, dark, noise)


def _check_codes(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Saturation below full scale, and gaps between the counts that occur."""
    full = capture.full_scale_dn
    piled, stepped = [], []
    for stack in stacks:
        if stack.kind == "dark":
            continue
        histogram = np.bincount(stack.counts.ravel())
        top = histogram.size - 1
        if top < full and _piled_pixels(histogram):
            piled.append((stack, top, _piled_pixels(histogram)))
        codes, expected = _different_counts(histogram)
        if expected > FEWEST_CODES and codes < SMALLEST_CODE_SHARE * expected:
            stepped.append((stack, codes, expected))
    if piled:
        stack, top, pixels = piled[0]
        yield Suspicion(
            "saturation below full scale: a wrong bit depth, clipped or rescaled frames",
            "camera.bit_depth" if len(piled) > len(stacks) / 4 else f"{stack.key}.frames",
            f"{pixels} pixels of {stack.key} have exactly {top} DN and none more (so in {len(piled)} tables); full "
            f"scale is {full} DN.",
        )
    if stepped:
        stack, codes, expected = stepped[0]
        yield Suspicion(
            "counts have gaps: frames were rescaled, gamma-encoded or reduced in bits",
            f"{stack.key}.frames",
            f"Only {codes:.0f} different counts occur where {expected:.0f} are expected (so in {len(stepped)} tables).",
        )


def _piled_pixels(histogram: NDArray[np.int64]) -> int:
    """Number of pixels at the largest count; 0 if the histogram is continuous there."""
    top = int(np.flatnonzero(histogram)[-1])
    near = histogram[max(top - PILE_NEIGHBOURS, 0) : top]
    expected = float(near.mean()) if near.size else 0.0
    return int(histogram[top]) if histogram[top] > max(FEWEST_PILED_PIXELS, PILE_RATIO * expected) else 0


def _different_counts(histogram: NDArray[np.int64]) -> tuple[float, float]:
    """Number of different counts in the darker half of the pixels: measured and expected.

    A smooth histogram has the expected number.
    """
    share = np.cumsum(histogram) / histogram.sum()
    low, high = np.searchsorted(share, [0.02, 0.5])
    part = histogram[low : high + 1].astype(float)
    if part.size < FEWEST_CODES:
        return 0.0, 0.0
    density = uniform_filter1d(part, min(SMOOTHING_DN, part.size), mode="nearest")
    return float(np.count_nonzero(part)), float(np.sum(1 - np.exp(-density)))


def _check_levels(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Levels of the frames relative to saturation and dark level."""
    full = capture.saturation_dn
    sigma = float(np.sqrt(noise.floor_dn2))
    for stack in stacks:
        if stack.kind in ("dark", "bracket"):
            continue
        saturated = float(np.mean(stack.counts >= full))
        is_bracketed = stack.kind == "band" and stack.band is not None and bool(capture.brackets(stack.band))
        if not is_bracketed and saturated > LARGEST_SATURATED_SHARE[stack.kind]:
            yield Suspicion(
                f"the {stack.kind} frames are overexposed",
                f"{stack.key}.frames",
                f"{saturated:.0%} of the pixels are saturated.",
            )
        level = stack.thinned(dark.at(stack.exposure_s))
        net = stack.mean - level
        if np.percentile(net, 99) < NO_LIGHT_SIGMAS * sigma + NO_LIGHT_SHARE * abs(float(np.median(level))):
            yield Suspicion(
                f"the {stack.kind} frames show no light (lens cap on, or dark frames)",
                f"{stack.key}.frames",
                f"99 of 100 pixels lie within {np.percentile(net, 99):.2g} DN of the dark level of "
                f"{np.median(level):.4g} DN.",
            )


def check_level_of_darks(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detect frames that are darker than the dark frames.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's noise of reading.

    Yields
    ------
    Suspicion
        At most one.
    """
    sigma = float(np.sqrt(noise.floor_dn2))
    below = []
    for stack in stacks:
        if stack.kind in ("dark", "bracket"):
            continue
        level = stack.thinned(dark.at(stack.exposure_s))
        lowest, middle = float(np.percentile(stack.mean - level, 0.5)), float(np.median(level))
        if middle > LOWEST_LEVEL_SIGMAS * sigma and lowest < -DARKER_SHARE * middle:
            below.append((stack, lowest, middle))
    if below:
        stack, lowest, middle = below[0]
        yield Suspicion(
            "frames are darker than the dark frames: the dark was subtracted before, or the dark frames hold light",
            f"{stack.key}.frames" if len(below) == 1 else "dark",
            f"A part of {stack.key} is {-lowest:.0f} DN below the dark level of {middle:.0f} DN (so in {len(below)} "
            "tables).",
        )
