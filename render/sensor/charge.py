"""Charge collected in another pixel than the one that generated it: leakage and blooming."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["leak", "spill_columns"]


def leak(electrons: NDArray[np.float64], horizontal: float, vertical: float) -> NDArray[np.float64]:
    """Expected electrons (y, x) after leakage to neighbouring pixels; the total is unchanged.

    horizontal, vertical : share that goes to each of the two neighbours in the row, in the column; at the edge of the
    array it stays in the pixel. Applied to expected values: electrons that move independently remain Poisson
    distributed.
    """
    padded = np.pad(electrons, 1, mode="edge")
    middle = (1 - 2 * horizontal - 2 * vertical) * electrons
    row = horizontal * (padded[1:-1, :-2] + padded[1:-1, 2:])
    return middle + row + vertical * (padded[:-2, 1:-1] + padded[2:, 1:-1])


def spill_columns(electrons: NDArray[np.float64], full_well_e: float) -> tuple[NDArray[np.float64], float]:
    """Blooming: charge above the full well flows along the column, half in each direction, into pixels with capacity.

    electrons : (y, x). Returns the electrons (y, x), at most ``full_well_e`` each, and the number lost at the ends of
    the columns; the total is conserved.
    """
    held = np.minimum(electrons, full_well_e)
    half = (electrons - held) / 2
    lost = 0.0
    for order in (range(len(held)), range(len(held) - 1, -1, -1)):
        carried = np.zeros(held.shape[1])
        for row in order:
            free = full_well_e - held[row]
            arriving = np.minimum(carried, free)
            held[row] += arriving
            carried += half[row] - arriving
        lost += float(carried.sum())
    return held, lost
