"""Charge that moves to another pixel than the one that generated it: leakage and blooming."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["leak", "spill_columns"]


def leak(electrons: NDArray[np.float64], horizontal: float, vertical: float) -> NDArray[np.float64]:
    """Expected electrons after leakage to neighbouring pixels; the total is unchanged.

    Applied to expected values: electrons that move independently remain Poisson distributed.

    Parameters
    ----------
    electrons
        (y, x) expected electrons.
    horizontal, vertical
        Share that goes to each of the two neighbours in the row, in the column. At the edge of the array it stays in
        the pixel.

    Returns
    -------
    NDArray
        (y, x) expected electrons.
    """
    padded = np.pad(electrons, 1, mode="edge")
    middle = (1 - 2 * horizontal - 2 * vertical) * electrons
    row = horizontal * (padded[1:-1, :-2] + padded[1:-1, 2:])
    return middle + row + vertical * (padded[:-2, 1:-1] + padded[2:, 1:-1])


def spill_columns(electrons: NDArray[np.float64], full_well_e: float) -> tuple[NDArray[np.float64], float]:
    """Blooming: charge above the full well flows along the column, half in each direction.

    It fills pixels with capacity. The total is conserved.

    Parameters
    ----------
    electrons
        (y, x) electrons.
    full_well_e
        Largest charge of a pixel, e-.

    Returns
    -------
    electrons : NDArray
        (y, x) electrons, up to ``full_well_e`` each.
    lost : float
        Electrons lost at the ends of the columns.
    """
    charge = np.minimum(electrons, full_well_e)
    half = (electrons - charge) / 2
    lost = 0.0
    for order in (range(len(charge)), range(len(charge) - 1, -1, -1)):
        carried = np.zeros(charge.shape[1])
        for row in order:
            free = full_well_e - charge[row]
            arriving = np.minimum(carried, free)
            charge[row] += arriving
            carried += half[row] - arriving
        lost += float(carried.sum())
    return charge, lost
