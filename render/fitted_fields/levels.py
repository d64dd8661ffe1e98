"""Counts by their level: what a converter or an amplifier adds to a count depends on the count."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

__all__ = ["LEVELS", "parts_of_levels"]

#: So many levels, evenly from 0 to the highest, between which is interpolated.
LEVELS = 48


def parts_of_levels(counts: NDArray[np.float64], most_dn: float) -> csr_matrix:
    """(LEVELS, n) the parts of each count (n,), above dark, in the level below and above it; ends are kept beyond."""
    place = np.clip(counts / most_dn, 0.0, 1.0) * (LEVELS - 1)
    below = np.minimum(place.astype(int), LEVELS - 2)
    above = place - below
    pixels = np.arange(len(counts))
    rows, columns = np.concatenate([below, below + 1]), np.concatenate([pixels, pixels])
    return csr_matrix((np.concatenate([1 - above, above]), (rows, columns)), (LEVELS, len(counts)))
