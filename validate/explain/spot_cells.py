"""Where the excess is densest, and bells that cover it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, label

from ..fields import ImageMaps
from .excess import Excess

__all__ = ["Spot", "cells", "hot_spot"]

#: A spot that is a larger part of the picture than this is none.
_LARGEST = 0.15

#: Most cells of a spot.
_MOST_CELLS = 200


@dataclass(frozen=True, eq=False)
class Spot:
    """Where the excess is densest. region : (y, x) connected pixels. centre_px : [x, y]. share : of the excess."""

    region: NDArray[np.bool_]
    centre_px: tuple[float, float]
    share: float


def hot_spot(excess: Excess) -> Spot | None:
    """The connected region about the highest excess of chi2; None where none stands out of noise."""
    bands = excess.used.sum(axis=0)
    over = np.sum(excess.residual.astype(float) ** 2, axis=0) - bands
    smooth = gaussian_filter(over, 1.5)
    noise = np.sqrt(2 * len(excess.bands)) / (2 * np.sqrt(np.pi) * 1.5)
    peak = float(smooth.max())
    if peak < 6 * noise:
        return None
    parts, _ = label(smooth > max(4 * noise, 0.05 * peak))
    region = parts == parts[np.unravel_index(np.argmax(smooth), smooth.shape)]
    region = binary_dilation(region, iterations=2)
    if region.mean() > _LARGEST:
        return None
    weights = np.where(region, np.maximum(over, 0), 0)
    y, x = np.indices(excess.shape)
    centre = float((x * weights).sum() / weights.sum()), float((y * weights).sum() / weights.sum())
    return Spot(region, centre, float(over[region].sum() / max(over.sum(), 1e-9)))


def cells(region: NDArray[np.bool_]) -> ImageMaps:
    """Bells over a region, as close as their number allows, 1 px at the least."""
    pitch = max(1.0, float(np.sqrt(region.sum() / _MOST_CELLS)))
    rows, columns = np.nonzero(region)
    centres = tuple(
        (float(u), float(v))
        for v in np.arange(rows.min(), rows.max() + pitch, pitch)
        for u in np.arange(columns.min(), columns.max() + pitch, pitch)
        if region[min(int(v), region.shape[0] - 1), min(int(u), region.shape[1] - 1)]
    )
    return ImageMaps("bells", centres=centres, pitch=pitch)
