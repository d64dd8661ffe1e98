"""Periodic patterns: checkerboards, columns, rows and grids.

The smooth parts are cut into blocks whose edge is a multiple of the period. A pattern adds the same Fourier coefficient
in every block, noise another one in each. Hotelling's test compares the mean coefficient with the scatter of blocks.
No variance has to be known, and a reconstruction filter changes the scatter as it changes the mean.
"""

from __future__ import annotations

from math import gcd

import numpy as np
from cboxlab.utils.distributions import fisher_tail, student_quantile, student_tail
from numpy.typing import NDArray

from .difference import Difference, Finding

__all__ = ["periodic", "without_period"]

#: Edges of blocks, px: their divisors are the periods from 2 to 10 px, and 12 and 16 px.
_BLOCKS_PX = (16, 12, 10, 14, 18, 8, 6)
#: Fewest blocks of a test.
_MIN_BLOCKS = 12
#: Part of a block's pixels that have to be smooth.
_MIN_SMOOTH_PART = 0.5
#: Probability of one harmonic among all frequencies, below which it has a pattern's period.
_HARMONIC = 1e-2
#: Amplitude of a harmonic over that of the clearest frequency, above which it is none of the smooth parts' outline.
_HARMONIC_PART = 0.3
#: Fewest pixels of a phase of a pattern that is removed.
_MIN_PHASE_PX = 8
#: Part of a grid's variance that a checkerboard explains, from which the grid is called one.
_CHECKERED_PART = 0.8


def periodic(difference: Difference) -> Finding | None:
    """Clearest periodic pattern.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The finding; None where the picture has too few smooth blocks.
    """
    tests = [test for test in (_tested(difference, edge) for edge in _BLOCKS_PX) if test is not None]
    if not tests:
        return None
    looks = sum(test[1].size for test in tests)
    edge, probability, strength, blocks = min(tests, key=lambda test: float(test[1].min()))
    least = float(probability.min())
    strong = strength >= _HARMONIC_PART * strength[np.unravel_index(probability.argmin(), probability.shape)]
    clear = np.argwhere(strong & (probability <= max(least, _HARMONIC / probability.size)))
    down, across = (edge // gcd(edge, *(int(k) for k in clear[:, axis])) for axis in (0, 1))
    folded = _folded(difference, down, across)
    size = float(np.sqrt(np.mean(folded**2)))
    name, parameters = _described(folded, down, across)
    degrees = float(blocks - 2)
    share = min(1.0, least * looks)
    statistic = float(student_quantile(share / 2, degrees)) if share > 1e-300 else 38.0
    return Finding(name, int(difference.smooth.sum()), size, size / max(statistic, 1e-12), degrees, share, parameters)


def without_period(difference: Difference, finding: Finding) -> NDArray[np.float64]:
    """Relative size of a periodic pattern at each pixel.

    Parameters
    ----------
    difference
        The difference.
    finding
        A finding of ``periodic``.

    Returns
    -------
    NDArray
        (y, x) pattern, with mean 0 over a period.
    """
    down, across = finding.parameters["period_y_px"], finding.parameters["period_x_px"]
    folded = _folded(difference, down, across)
    rows, columns = np.indices(difference.level.shape)
    return np.asarray(folded[rows % down, columns % across])


def _tested(difference: Difference, edge: int) -> tuple[int, NDArray[np.float64], NDArray[np.float64], int] | None:
    """Edge and count of blocks; probabilities and amplitudes (v, u) by frequency."""
    height, width = (size // edge * edge for size in difference.level.shape)
    if not (height and width):
        return None

    def cut(picture: NDArray) -> NDArray:
        parts = picture[:height, :width].reshape(height // edge, edge, width // edge, edge)
        return parts.swapaxes(1, 2).reshape(-1, edge, edge)

    smooth = cut(difference.smooth)
    pixels = smooth.sum(axis=(1, 2))
    used = pixels >= _MIN_SMOOTH_PART * edge**2
    count = int(used.sum())
    if count < _MIN_BLOCKS:
        return None
    smooth, values, pixels = smooth[used], cut(difference.relative)[used], pixels[used]
    centred = np.where(smooth, values - (values.sum(axis=(1, 2)) / pixels)[:, None, None], 0.0)
    spectra = np.fft.rfft2(centred) / pixels[:, None, None]
    return edge, _hotelling(spectra), np.abs(spectra.mean(axis=0)), count


def _hotelling(spectra: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(v, u) probabilities that coefficients (n, v, u) have mean 0."""
    count, edge = spectra.shape[:2]
    mean = spectra.mean(axis=0)
    off = spectra - mean
    real, imaginary = off.real, off.imag
    a, b, c = ((p * q).sum(axis=0) / (count - 1) for p, q in ((real, real), (real, imaginary), (imaginary, imaginary)))
    determinant = np.maximum(a * c - b**2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = count * (c * mean.real**2 - 2 * b * mean.real * mean.imag + a * mean.imag**2) / determinant
        single = count * mean.real**2 / a
    both = fisher_tail(np.nan_to_num(square, posinf=1e30) * (count - 2) / (2 * (count - 1)), 2, count - 2)
    # coefficients at 0 and at half a cycle a pixel are real along either axis
    real_bins = [0] if edge % 2 else [0, edge // 2]
    alone = 2 * student_tail(np.sqrt(np.nan_to_num(single, posinf=1e30)), count - 1)
    result = np.asarray(both)
    result[np.ix_(real_bins, real_bins)] = alone[np.ix_(real_bins, real_bins)]
    # frequencies of u = 0 and u = edge / 2 stand twice, and the mean is removed
    result[edge // 2 + 1 :][:, real_bins] = 1.0
    result[0, 0] = 1.0
    return result


def _folded(difference: Difference, down: int, across: int) -> NDArray[np.float64]:
    """(down, across) mean of the relative difference by phase, less its mean."""
    rows, columns = np.nonzero(difference.smooth)
    phase = rows % down * across + columns % across
    counts = np.bincount(phase, minlength=down * across)
    sums = np.bincount(phase, difference.relative[rows, columns], down * across)
    means = np.where(counts >= _MIN_PHASE_PX, sums / np.maximum(counts, 1), np.nan)
    if not np.isfinite(means).any():
        return np.zeros((down, across))
    return np.nan_to_num(means - np.nanmean(means)).reshape(down, across)


def _described(folded: NDArray[np.float64], down: int, across: int) -> tuple[str, dict[str, int]]:
    """Words for a pattern, and its periods."""
    parameters = {"period_y_px": down, "period_x_px": across}
    if down == 1:
        return f"columns with a period of {across} px", parameters
    if across == 1:
        return f"rows with a period of {down} px", parameters
    if down == across and down % 2 == 0 and _checkered(folded) > _CHECKERED_PART:
        return f"checkerboard of {down // 2} px", parameters
    return f"grid with periods of {across} x {down} px", parameters


def _checkered(folded: NDArray[np.float64]) -> float:
    """Part of a folded pattern's variance that a checkerboard explains."""
    rows, columns = np.indices(folded.shape)
    half = len(folded) // 2
    power = float((folded**2).sum())
    best = 0.0
    for y in range(half):
        for x in range(half):
            sign = np.where(((rows + y) // half + (columns + x) // half) % 2, 1.0, -1.0)
            best = max(best, float((folded * sign).sum()) ** 2 / folded.size)
    return best / power if power else 0.0
