"""Maps of counts by their level.

An error of the converter or the amplifier depends on the count alone, so it is a function of the level.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

__all__ = ["LEVELS", "parts_of_levels"]

#: Number of levels, evenly from 0 to the highest count; functions of the count are linear in between.
LEVELS = 48


def parts_of_levels(counts: NDArray[np.float64], most_dn: float) -> csr_matrix:
    """Weights of the linear interpolation between levels.

    Parameters
    ----------
    counts
        (n,) counts above dark, DN. Those below 0 or above ``most_dn`` have the weights of the end.
    most_dn
        Highest level, DN.

    Returns
    -------
    csr_matrix
        (LEVELS, n) weights; each count has two, which sum to 1.
    """
    level = np.clip(counts / most_dn, 0.0, 1.0) * (LEVELS - 1)
    below = np.minimum(level.astype(int), LEVELS - 2)
    above = level - below
    pixels = np.arange(len(counts))
    rows, columns = np.concatenate([below, below + 1]), np.concatenate([pixels, pixels])
    return csr_matrix((np.concatenate([1 - above, above]), (rows, columns)), (LEVELS, len(counts)))
