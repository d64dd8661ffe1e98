"""The full well of a sensor whose pixels saturate below the largest count of the converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture, FrameTable

__all__ = ["with_full_well"]

# The temporal variance of light rises with its level. In full pixels only read noise is left: their variance is below
# this share of the largest one, and their counts lie within this share of their level.
_FALLEN, _PILED = 0.3, 0.01
# Levels of a table that are compared, and pixels in each.
_LEVELS, _FEWEST_IN_LEVEL = 40, 30
# Standard deviations of read noise by which the counts of a full pixel differ from each other.
_SIGMAS = 4.0


def _saturated_count(stack: NDArray[np.uint16], full_scale_dn: int) -> float | None:
    """The lowest count (DN) of the full pixels in repeats (repeat, y, x) of one exposure.

    None if there are none, or if it is the converter that saturates them.
    """
    mean, variance = stack.mean(axis=0).ravel(), stack.var(axis=0, ddof=1).ravel()
    order = np.argsort(mean)
    levels = np.array_split(order, max(1, min(_LEVELS, order.size // _FEWEST_IN_LEVEL)))
    noise = np.array([variance[level].mean() for level in levels])
    full = _FALLEN * noise.max() > noise
    full[: int(np.argmax(noise))] = False
    # from the brightest level downwards, without a gap
    full = np.cumprod(full[::-1])[::-1].astype(bool)
    if not full.any():
        return None
    own = np.concatenate([level for level, is_full in zip(levels, full, strict=True) if is_full])
    low, high = np.percentile(mean[own], [5, 95])
    piled = high - low < _PILED * high and high < full_scale_dn
    return float(low - _SIGMAS * np.sqrt(variance[own].mean())) if piled else None


def with_full_well(capture: Capture) -> Capture:
    """The capture with its full well, if pixels saturate below full scale in an exposure with repeats.

    Only an exposure that is saturated in part shows it: its full pixels have less noise than its darker ones. Raises
    InputError for a faulty frame.
    """
    manifest = capture.manifest
    tables: list[FrameTable] = [*manifest.band, *manifest.bracket, *manifest.flats, *manifest.reference]
    found = [
        _saturated_count(capture.frames(table), capture.full_scale_dn) for table in tables if len(table.frames) > 1
    ]
    counts = [count for count in found if count is not None]
    return replace(capture, full_well_dn=int(min(counts))) if counts else capture
