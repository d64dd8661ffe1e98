"""Light that a pixel exchanges with others: neighbours on opposite sides, along lines, and wide Gaussians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

__all__ = ["HALO_WIDTHS_PX", "along_lines", "neighbour_steps", "with_halo", "with_neighbours"]

#: Standard deviations of the Gaussians of a halo, px.
HALO_WIDTHS_PX = (1.5, 3.0, 6.0, 12.0, 24.0)


def neighbour_steps(radius: int) -> list[tuple[int, int]]:
    """(down, right) to half of the neighbours within a square; the others are opposite to them."""
    return [(i, j) for i in range(radius + 1) for j in range(-radius, radius + 1) if i > 0 or j > 0]


def with_neighbours(signal: NDArray[np.float64], step: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) mean of the two neighbours at a step less the pixel: such an exchange moves nothing."""
    ends = [shift(signal, np.multiply(sign, step), order=0, mode="nearest") for sign in (1, -1)]
    return np.asarray(sum(ends) / 2 - signal)


def along_lines(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, y, x) exchange along rows less that along columns, and along the falling less that along the rising diagonal.

    Two numbers make any blur along a line out of a round one, to second order in its length.
    """
    return np.array([
        with_neighbours(signal, (0, 1)) - with_neighbours(signal, (1, 0)),
        with_neighbours(signal, (1, 1)) - with_neighbours(signal, (1, -1)),
    ])  # fmt: skip


def with_halo(signal: NDArray[np.float64], width_px: float) -> NDArray[np.float64]:
    """(y, x) the picture blurred by a Gaussian less itself."""
    return np.asarray(gaussian_filter(signal, width_px, mode="nearest") - signal)
