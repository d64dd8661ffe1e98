"""The full well of a sensor whose pixels saturate below the largest count of the converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture, FrameTable

__all__ = ["with_full_well"]

#: Share of the largest temporal variance below which pixels are full: shot noise rises with light, read noise stays.
_MAX_FULL_VARIANCE_SHARE = 0.3
#: Spread of the counts of full pixels relative to their level, at most.
_MAX_RELATIVE_SPREAD = 0.01
#: Number of brightness levels of a table that are compared.
_MAX_LEVELS = 40
#: Pixels in each level, at least.
_MIN_PIXELS_IN_LEVEL = 30
#: Standard deviations of read noise by which the counts of a full pixel differ from each other.
_READ_NOISE_SIGMAS = 4.0


def _saturated_count(stack: NDArray[np.uint16], full_scale_dn: int) -> float | None:
    """Lowest count of the full pixels in repeats (repeat, y, x) of one exposure, DN.

    None if there are none, or if it is the converter that saturates them.
    """
    mean, variance = stack.mean(axis=0).ravel(), stack.var(axis=0, ddof=1).ravel()
    order = np.argsort(mean)
    levels = np.array_split(order, max(1, min(_MAX_LEVELS, order.size // _MIN_PIXELS_IN_LEVEL)))
    noise = np.array([variance[level].mean() for level in levels])
    full = _MAX_FULL_VARIANCE_SHARE * noise.max() > noise
    full[: int(np.argmax(noise))] = False
    # from the brightest level downwards, without a gap
    full = np.cumprod(full[::-1])[::-1].astype(bool)
    if not full.any():
        return None
    full_pixels = np.concatenate([level for level, is_full in zip(levels, full, strict=True) if is_full])
    low, high = np.percentile(mean[full_pixels], [5, 95])
    piled = high - low < _MAX_RELATIVE_SPREAD * high and high < full_scale_dn
    return float(low - _READ_NOISE_SIGMAS * np.sqrt(variance[full_pixels].mean())) if piled else None


def with_full_well(capture: Capture) -> Capture:
    """The capture with its full well, if pixels saturate below full scale.

    Only an exposure with repeats that is saturated in part shows it: its full pixels have less noise than its
    darker ones.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    Capture
        With ``full_well_dn`` set to the lowest full well of all exposures; ``capture`` itself where none shows one.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    manifest = capture.manifest
    tables: list[FrameTable] = [*manifest.band, *manifest.bracket, *manifest.flats, *manifest.reference]
    saturated_counts = [
        _saturated_count(capture.frames(table), capture.full_scale_dn) for table in tables if len(table.frames) > 1
    ]
    counts = [count for count in saturated_counts if count is not None]
    return replace(capture, full_well_dn=int(min(counts))) if counts else capture
