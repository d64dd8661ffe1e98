"""Variances of few batches, pooled with those of neighbours and widened by Student's t."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

__all__ = ["MANY_BATCHES", "pooled_variance"]

#: Batches from which a pixel's own variance is good enough: squares of errors are then 7 % too large.
MANY_BATCHES = 32
#: Batches assumed behind a standard error whose file states none.
_ASSUMED_BATCHES = 4
#: Pixels a side of the neighbourhood.
_WINDOW_PX = 5
#: Neighbours that count at most: variances are alike, not equal.
_MOST_NEIGHBOURS = 5.0
#: Part of the radiance that is added to the range at edges, so that the scale is never 0.
_LEAST_SCALE = 0.02


def pooled_variance(
    radiance: NDArray[np.float64], variance: NDArray[np.float64], edges: NDArray[np.bool_], batches: int
) -> NDArray[np.float64]:
    """Variance of each pixel by which squared errors are 1 on average, as those of a normal are.

    Noise is in proportion to the radiance inside surfaces, and to the range of the neighbours at edges.

    Parameters
    ----------
    radiance
        (y, x, w) radiance.
    variance
        (y, x, w) variance of its mean over batches.
    edges
        (y, x) pixels that see more than one surface.
    batches
        Number of batches; 0 where unknown.

    Returns
    -------
    NDArray
        (y, x, w) variance; itself from many batches.
    """
    count = batches if batches >= 2 else _ASSUMED_BATCHES
    if count >= MANY_BATCHES:
        return variance
    pixel_degrees = count - 1.0
    ranges = maximum_filter(radiance, (3, 3, 1)) - minimum_filter(radiance, (3, 3, 1))
    scale = np.where(edges[..., None], ranges, 0.0) + np.where(edges[..., None], _LEAST_SCALE, 1.0) * np.abs(radiance)
    scale = np.maximum(scale, 1e-6 * max(float(np.abs(radiance).mean()), 1e-300))
    relative = variance / scale**2
    result = np.empty_like(variance)
    for mask in (edges, ~edges):
        members = uniform_filter(mask.astype(float), _WINDOW_PX) * _WINDOW_PX**2 - mask
        inside = np.where(mask[..., None], relative, 0.0)
        sums = uniform_filter(inside, (_WINDOW_PX, _WINDOW_PX, 1)) * _WINDOW_PX**2 - inside
        others = np.minimum(np.maximum(members, 0.0), _MOST_NEIGHBOURS)[..., None]
        around = sums / np.maximum(members, 1.0)[..., None]
        degrees = pixel_degrees * (1 + others)
        pooled = (relative + others * np.maximum(around, 0.0)) / (1 + others)
        wider = degrees / np.maximum(degrees - 2, 0.5)
        result[mask] = (pooled * wider * scale**2)[mask]
    return result
