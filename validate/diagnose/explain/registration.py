"""Registration of a residual: where it is fixed, its sign, and how it scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from ..field_fit import LEAST_DIVISOR, ResidualData
from .noise import noise_level

__all__ = ["Registration", "registration"]

#: Sides of the squares in which a pattern is taken as constant, px: the side that explains most is used.
_SQUARES_PX = (1, 2, 4, 8)


@dataclass(frozen=True)
class Registration:
    """Size of the excess, and shares of it, 0 to 1, by patterns, free numbers deducted.

    The shares overlap, and do not add up to 1.
    """

    #: Excess of chi2 per sample over noise.
    per_sample: float
    #: Part of the excess in which counts are missing; the rest is counts too many.
    missing: float
    #: A pattern in proportion to the signal, alike in all bands.
    by_signal: float
    #: Counts that all bands share, whatever the signal.
    by_count: float
    #: Counts in proportion to the exposure time.
    by_exposure: float
    #: One relative number for each band.
    in_bands: float
    #: One relative number for each surface and band.
    on_surfaces: float
    #: One relative number for each row.
    in_rows: float
    #: One relative number for each column.
    in_columns: float
    #: One relative number for each pixel, less what squares of 2 x 2 pixels explain.
    in_pixels: float
    #: The excess of pixels at edges between surfaces over their part of the picture.
    at_edges: float
    #: The excess of the tenth of the picture's squares that differ most: 0 for half of it, 1 for all.
    in_places: float


def registration(data: ResidualData) -> Registration:
    """Registration of a residual.

    Parameters
    ----------
    data
        The residual.

    Returns
    -------
    Registration
        Shares of its excess over noise.
    """
    noise = noise_level(data.residual, data.used)
    square = data.residual.astype(float) ** 2
    excess = max(float(square.sum()) - noise * data.count, 1.0)
    rows, columns = np.indices(data.shape)
    bands = np.arange(len(data.bands))[:, None, None]
    surfaces = data.surface - data.surface.min() + 1
    flat = 1 / np.maximum(data.flat, LEAST_DIVISOR)
    exposure = data.exposure_s[:, None, None] / data.exposure_s.max()

    def share(operator: NDArray[Any], labels: NDArray[Any]) -> float:
        return float(np.clip(_gain(data, operator, labels, noise) / excess, 0, 1))

    def squares(side: int) -> NDArray[np.int64]:
        return np.asarray(rows // side * data.shape[1] + columns // side)

    by_squares = {side: share(data.signal, squares(side)) for side in _SQUARES_PX}
    side = max(by_squares, key=lambda size: by_squares[size])
    where = squares(side)
    edges = (maximum_filter(surfaces, 3) != minimum_filter(surfaces, 3)) & data.used.any(axis=0)
    at_edges = float((square - noise * data.used)[:, edges].sum()) / excess
    return Registration(
        per_sample=excess / data.count,
        missing=_missing(data, square, noise),
        by_signal=by_squares[side],
        by_count=share(flat, where),
        by_exposure=share(flat * exposure, where),
        in_bands=share(data.signal, bands),
        on_surfaces=share(data.signal, surfaces * len(bands) + bands),
        in_rows=share(data.signal, rows),
        in_columns=share(data.signal, columns),
        in_pixels=max(by_squares[1] - by_squares[2], 0.0),
        at_edges=float(np.clip(at_edges - edges.mean(), 0, 1)),
        in_places=_in_places(square - noise * data.used, squares(4), excess),
    )


def _missing(data: ResidualData, square: NDArray[np.float64], noise: float) -> float:
    """Part of the excess in which counts are missing; noise is even."""
    below, above = (
        max(float(square[sign * data.residual > 0].sum()) - noise * data.count / 2, 0.0) for sign in (-1, 1)
    )
    return below / max(below + above, 1e-300)


def _gain(data: ResidualData, operator: NDArray[Any], labels: NDArray[Any], noise: float) -> float:
    """Chi2 explained by one number for each label, less what noise makes of as many numbers.

    Behind a mosaic a label of a single sample explains nothing: each pixel of a frame is one.
    """
    whitened = np.broadcast_to(operator, data.used.shape) * data.weight
    groups = np.broadcast_to(labels, data.used.shape).ravel()
    product = np.bincount(groups, (whitened * data.residual).ravel())
    power = np.bincount(groups, (whitened**2).ravel())
    least = 1 if data.cell is None else 2
    determined = np.bincount(groups, (whitened != 0).ravel()) >= least
    return float(np.sum(product[determined] ** 2 / power[determined]) - noise * determined.sum())


def _in_places(over: NDArray[np.float64], where: NDArray[np.int64], excess: float) -> float:
    """Share of the excess in the tenth of the squares with most of it."""
    sums = np.sort(np.bincount(where.ravel(), over.sum(axis=0).ravel())[np.unique(where)])
    return float(np.clip(2 * sums[-max(len(sums) // 10, 1) :].sum() / excess - 1, 0, 1))
