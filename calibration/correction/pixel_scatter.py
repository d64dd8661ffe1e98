"""Scatter of the pixels' sensitivities, where no flat shows it.

Without flats every pixel has an unknown sensitivity, whose scatter counts as noise. It is estimated twice: first from
the differences of neighbours in the pictures, which shading and edges widen; then from those of the residuals of a
comparison. The rendering takes shading and edges away. What the model lacks changes gradually or at few edges, hardly
changes these differences, and stays visible.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .picture_noise import FEWEST, clipped_variance, second_differences, smooth_pixels, truncated_variance

__all__ = ["pixel_scatter", "scatter_of_residuals"]

#: Standard deviations beyond which a difference of residuals is an edge or a defect, and no scatter.
_CLIP = 3.0
#: Second difference of the rendering, relative and scaled to one pixel's variance, from which on three pixels lie
#: across an edge. One rendered a tenth of a pixel aside changes them by as much as usual sensitivities scatter.
_EDGE = 0.1
#: Rounds of the fit: each one reduces the error of the variance by a factor of 10 at least.
_ROUNDS = 30


def pixel_scatter(
    signal: NDArray[np.float64],
    variance: NDArray[np.float64],
    usable: NDArray[np.bool_],
    step: tuple[int, int] = (1, 1),
) -> float:
    """Relative scatter of the pixels' sensitivities in the bright half of a picture.

    Parameters
    ----------
    signal
        (y, x) signal above dark, DN.
    variance
        (y, x) variance of its temporal noise, DN^2.
    usable
        (y, x) True for pixels used.
    step
        (rows, columns) distance of neighbours with the same filter, px.

    Returns
    -------
    float
        Standard deviation, 0 where temporal noise explains the scatter; NaN with too few pixels.
    """
    if not usable.any():
        return float("nan")
    bright = usable & (signal >= max(float(np.median(signal[usable])), 0.0)) & (signal > 0)
    smooth = smooth_pixels(signal, bright, step)
    differences, means = second_differences(signal, smooth, step)
    if differences.size < FEWEST:
        return float("nan")
    _, temporal = second_differences(variance, smooth, step)
    relative = clipped_variance(differences / means) - float(np.median(temporal / means**2))
    return float(np.sqrt(max(relative, 0.0)))


def scatter_of_residuals(
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    variance: NDArray[np.float64],
    usable: NDArray[np.bool_],
    step: tuple[int, int] = (1, 1),
) -> float:
    """Relative scatter of the pixels' sensitivities in the residuals of a comparison.

    The variance of a difference is that of its noise and of the scatter. The scatter that makes the differences most
    probable counts, without those beyond three standard deviations.

    Parameters
    ----------
    measured
        (band, y, x) measured signals, DN.
    rendered
        (band, y, x) rendered signals, DN.
    variance
        (band, y, x) variance of measured minus rendered, without the scatter, DN^2.
    usable
        (band, y, x) True for pixels used; those without rendered light are left out.
    step
        (rows, columns) distance of neighbours with the same filter, px.

    Returns
    -------
    float
        Standard deviation, 0 where noise explains the differences; NaN with too few pixels.
    """
    lit = usable & (rendered > 0)
    unit = np.where(lit, rendered, 1.0)
    differences, noises = [], []
    for band, used in enumerate(lit):
        curvature, level = second_differences(rendered[band], used, step)
        inside = np.abs(curvature) < _EDGE * level
        differences.append(second_differences(measured[band] / unit[band], used, step)[0][inside])
        noises.append(second_differences(variance[band] / unit[band] ** 2, used, step)[1][inside])
    difference, of_noise = np.concatenate(differences), np.concatenate(noises)
    if difference.size < FEWEST:
        return float("nan")
    square, truncated = difference**2, truncated_variance(_CLIP)
    scatter = clipped_variance(difference)
    for _ in range(_ROUNDS):
        total = of_noise + scatter
        weight = (square <= _CLIP**2 * total) / total**2
        scatter = max(float(np.sum(weight * (square / truncated - of_noise)) / np.sum(weight)), 0.0)
    return float(np.sqrt(scatter))
