"""Error of sums over blocks behind a mosaic, whose pixels of one channel lie apart.

Where an edge crosses a block, the mean of its summed pixels differs from that of the block. Their scatter shows the
edge if noise and the pixels' own sensitivities are known: the noise from the model of a count, the sensitivities from
a flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..capture import BandTable, Capture, FrameTable
from .dark import DarkLibrary
from .noise import NoiseModel

__all__ = ["sampling_variance"]

#: Groups of blocks of similar sums, through whose median scatters a line of the noise goes where there is no flat.
_LEVELS = 40


def sampling_variance(
    capture: Capture, table: FrameTable, dark: DarkLibrary, noise: NoiseModel
) -> NDArray[np.float64] | None:
    """Variance of a table's mean counts because sums behind a mosaic leave pixels out.

    Parameters
    ----------
    capture
        The capture.
    table
        A table of the manifest.
    dark
        The capture's dark levels.
    noise
        Noise model of one count.

    Returns
    -------
    NDArray | None
        (y, x) variance, DN^2, the same in all repeats; None where all pixels count.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    scatter, reduction = capture.block_scatter(table), capture.reduction
    if scatter is None or reduction is None:
        return None
    sums, spread = scatter
    pixels = reduction.summed**2
    band = table.id if isinstance(table, BandTable) else getattr(table, "band", None)
    flats = [flat for flat in capture.manifest.flats if flat.band == band]
    of_flat = capture.block_scatter(flats[0]) if flats else None
    if of_flat is None:
        by_noise = _line_of_medians(sums, spread)
    else:
        level, flat_spread = of_flat[0] - dark.bias, of_flat[1]
        bright = level > 0
        excess = (flat_spread - noise.variance(level) / pixels)[bright] / (level[bright] / pixels) ** 2
        sensitivities = max(float(np.median(excess)), 0.0) if excess.size else 0.0
        light = np.maximum(sums - dark.bias, 0.0)
        by_noise = noise.variance(light) / pixels + sensitivities * (light / pixels) ** 2
    return reduction.sampling_variance(spread, by_noise, len(table.frames))


def _line_of_medians(sums: NDArray[np.float64], spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) scatter by noise, linear in the sums, from medians: most blocks see no edge."""
    from scipy.stats import theilslopes  # slow to import, rarely needed

    groups = np.array_split(np.argsort(sums, axis=None), _LEVELS)
    pairs = [np.median([sums.ravel()[g], spread.ravel()[g]], axis=1) for g in groups if g.size]
    slope, constant, *_ = theilslopes([pair[1] for pair in pairs], [pair[0] for pair in pairs])
    return np.asarray(np.maximum(constant + slope * sums, 0.0), np.float64)
