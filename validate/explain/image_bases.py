"""Families of images: smooth waves over the picture, rows, columns, one wave, cells where the excess is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, label
from scipy.sparse import csr_matrix, identity, kron, lil_matrix

from .excess import Excess

__all__ = ["Spot", "cells", "columns", "cosines", "hot_spot", "rows", "wave"]

#: Order beyond which the prior width of cosines falls.
_CORNER = 3.0

#: A spot that is a larger part of the picture than this is none.
_LARGEST = 0.15

#: Most cells of a spot.
_MOST_CELLS = 200


def cosines(shape: tuple[int, int], order: int) -> NDArray[np.float64]:
    """(k, pixel) products of cosines with up to ``order`` half waves together, falling with their number."""
    y, x = ((np.arange(n) + 0.5) / n for n in shape)
    found = []
    for i in range(order + 1):
        for j in range(order + 1 - i):
            size = 1 / (1 + (np.hypot(i, j) / _CORNER) ** 2)
            found.append(size * np.outer(np.cos(np.pi * i * y), np.cos(np.pi * j * x)).ravel())
    return np.array(found)


def rows(shape: tuple[int, int]) -> csr_matrix:
    """(row, pixel) one image for each row."""
    return csr_matrix(kron(identity(shape[0]), np.ones((1, shape[1]))))


def columns(shape: tuple[int, int]) -> csr_matrix:
    """(column, pixel) one image for each column."""
    return csr_matrix(kron(np.ones((1, shape[0])), identity(shape[1])))


def wave(shape: tuple[int, int], per_px: tuple[float, float]) -> NDArray[np.float64]:
    """(2, pixel) cosine and sine of a frequency (down, right)."""
    y, x = np.indices(shape)
    phase = 2 * np.pi * (per_px[0] * y + per_px[1] * x).ravel()
    return np.array([np.cos(phase), np.sin(phase)])


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


def cells(region: NDArray[np.bool_]) -> csr_matrix:
    """(k, pixel) bells over a region, as close as their number allows, 1 px at the least."""
    pitch = max(1.0, float(np.sqrt(region.sum() / _MOST_CELLS)))
    y, x = np.indices(region.shape)
    rows_, columns_ = np.nonzero(region)
    grid = [
        (v, u)
        for v in np.arange(rows_.min(), rows_.max() + pitch, pitch)
        for u in np.arange(columns_.min(), columns_.max() + pitch, pitch)
        if region[min(int(v), region.shape[0] - 1), min(int(u), region.shape[1] - 1)]
    ]
    wide = 2 * (0.6 * pitch) ** 2
    inside = region.ravel()
    v, u = np.array(grid).T
    bells = np.exp(-((y.ravel()[inside] - v[:, None]) ** 2 + (x.ravel()[inside] - u[:, None]) ** 2) / wide)
    found = lil_matrix((len(grid), inside.size))
    found[:, np.flatnonzero(inside)] = bells
    return csr_matrix(found)
