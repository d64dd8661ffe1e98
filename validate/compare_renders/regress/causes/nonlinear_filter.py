"""Nonlinear filters of a finished picture: median, and bilateral as denoisers are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Edges of medians, px.
_MEDIANS_PX = (3, 5)
#: Reach of bilateral filters, px.
_REACHES_PX = (2, 4)
#: Differences of logarithms at which a bilateral filter's weight falls.
_RANGES = (0.1, 0.3)


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Filters of usual sizes on the baseline."""
    base = pictures.baseline
    for edge in _MEDIANS_PX:
        filtered = median_filter(base, (edge, edge, 1), mode="nearest")
        yield Trial(fixed_values({"filter": "median", "edge_px": edge}), fixed=filtered - base, selected=1)
    for reach in _REACHES_PX:
        for width in _RANGES:
            filtered = _bilateral(base, reach, width)
            parameters = {"filter": "bilateral", "reach_px": reach, "range": width}
            yield Trial(fixed_values(parameters), fixed=filtered - base, selected=2)


def _bilateral(picture: NDArray[np.float64], reach: int, width: float) -> NDArray[np.float64]:
    """(y, x, w) mean of neighbours of similar light."""
    light = np.log(np.maximum(picture.sum(axis=-1), 1e-6 * max(float(picture.sum(axis=-1).mean()), 1e-300)))
    total, weights = np.zeros_like(picture), np.zeros(picture.shape[:2])
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            moved = np.roll(light, (down, right), (0, 1))
            near = np.exp(-(down**2 + right**2) / (reach**2) - (moved - light) ** 2 / (2 * width**2))
            total += near[..., None] * np.roll(picture, (down, right), (0, 1))
            weights += near
    return np.asarray(total / weights[..., None])


CAUSE = Cause(
    "nonlinear-filter",
    "The finished picture went through a median, a bilateral filter or a denoiser.",
    _trials,
    edge_error=0.2,
)
