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

__all__ = ["check_counts"]

#: Smallest number of pixels at the largest count of a table, absolute and relative to the counts below it.
_FEWEST_PILED, _PILE = 12, 12.0
#: Smallest ratio of the number of different counts to that expected from a smooth histogram.
_SHARE_OF_CODES = 0.6
_FEWEST_CODES = 25
_MOST_SATURATED = {"band": 0.3, "flat": 0.1, "reference": 0.1}


def _piled(histogram: NDArray[np.int64]) -> int:
    """Number of pixels at the largest count; 0 if the histogram is continuous there."""
    top = int(np.flatnonzero(histogram)[-1])
    near = histogram[max(top - 20, 0) : top]
    expected = float(near.mean()) if near.size else 0.0
    return int(histogram[top]) if histogram[top] > max(_FEWEST_PILED, _PILE * expected) else 0


def _codes(histogram: NDArray[np.int64]) -> tuple[float, float]:
    """Number of different counts in the lower half of the pixels, and the number expected from a smooth histogram."""
    share = np.cumsum(histogram) / histogram.sum()
    low, high = np.searchsorted(share, [0.02, 0.5])
    part = histogram[low : high + 1].astype(float)
    if part.size < _FEWEST_CODES:
        return 0.0, 0.0
    density = uniform_filter1d(part, min(65, part.size), mode="nearest")
    return float(np.count_nonzero(part)), float(np.sum(1 - np.exp(-density)))


def _scale(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    full = capture.full_scale_dn
    piled, stepped = [], []
    for stack in stacks:
        if stack.kind == "dark":
            continue
        histogram = np.bincount(stack.counts.ravel())
        top = histogram.size - 1
        if top < full and _piled(histogram):
            piled.append((stack, top, _piled(histogram)))
        found, expected = _codes(histogram)
        if expected > _FEWEST_CODES and found < _SHARE_OF_CODES * expected:
            stepped.append((stack, found, expected))
    if piled:
        stack, top, pixels = piled[0]
        yield Suspicion(
            "saturation below full scale: a wrong bit depth, clipped or rescaled frames",
            "camera.bit_depth" if len(piled) > len(stacks) / 4 else f"{stack.key}.frames",
            f"{pixels} pixels of {stack.key} have exactly {top} DN and none more (so in {len(piled)} tables); full "
            f"scale is {full} DN.",
        )
    if stepped:
        stack, found, expected = stepped[0]
        yield Suspicion(
            "counts have gaps: frames were rescaled, gamma-encoded or reduced in bits",
            f"{stack.key}.frames",
            f"Only {found:.0f} different counts occur where {expected:.0f} are expected (so in {len(stepped)} tables).",
        )


def _levels(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel) -> Iterator[Suspicion]:
    full = capture.saturation_dn
    sigma = float(np.sqrt(noise.floor_dn2))
    below = []
    for stack in stacks:
        if stack.kind in ("dark", "bracket"):
            continue
        saturated = float(np.mean(stack.counts >= full))
        if saturated > _MOST_SATURATED[stack.kind]:
            yield Suspicion(
                f"the {stack.kind} frames are overexposed",
                f"{stack.key}.frames",
                f"{saturated:.0%} of the pixels are saturated.",
            )
        level = stack.thinned(dark.at(stack.exposure_s))
        net = stack.mean - level
        if np.percentile(net, 99) < 3 * sigma + 0.02 * abs(float(np.median(level))):
            yield Suspicion(
                f"the {stack.kind} frames show no light (lens cap on, or dark frames)",
                f"{stack.key}.frames",
                f"99 of 100 pixels lie within {np.percentile(net, 99):.2g} DN of the dark level of "
                f"{np.median(level):.4g} DN.",
            )
        lowest, middle = float(np.percentile(net, 0.5)), float(np.median(level))
        if middle > 10 * sigma and lowest < -0.5 * middle:
            below.append((stack, lowest, middle))
    if below:
        stack, lowest, middle = below[0]
        yield Suspicion(
            "frames are darker than the dark frames: the dark was subtracted before, or the dark frames hold light",
            f"{stack.key}.frames" if len(below) == 1 else "dark",
            f"A part of {stack.key} is {-lowest:.0f} DN below the dark level of {middle:.0f} DN (so in {len(below)} "
            "tables).",
        )


def check_counts(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Checks saturation, gaps between counts, and levels relative to full scale and dark."""
    yield from _scale(capture, stacks)
    yield from _levels(capture, stacks, dark, noise)
