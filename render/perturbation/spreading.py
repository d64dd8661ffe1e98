"""Traced pixels of a large picture, which stand for their neighbours on the same face.

Light by a lobe of 0.03 rad or wider varies little from pixel to pixel of one face: 0.03 rad are eleven pixels of 256
across the box. So rays are traced for every other row and column, and for pixels that see several faces.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array

__all__ = ["SMALL_PICTURE_PX", "spreading"]

#: Number of pixels up to which all are traced: in a larger picture fewer rays of each say as much.
SMALL_PICTURE_PX = 2**15


def spreading(face: NDArray[np.int64]) -> csr_array:
    """Weights by which traced pixels stand for all.

    Parameters
    ----------
    face
        (y, x) index of the only face that a pixel sees, -1 for several or none.

    Returns
    -------
    csr_array
        (pixel, pixel) weights, each row's sum 1. Traced pixels have 1 on the diagonal, the others 0.
    """
    rows, columns = np.indices(face.shape)
    on_grid = (rows % 2 == 0) & (columns % 2 == 0)
    around = np.pad(np.where(on_grid, face, -1), 1, constant_values=-1)
    index = np.pad(np.arange(face.size).reshape(face.shape), 1)
    others, pixels = [], []
    for down, right in product(range(3), repeat=2):
        window = slice(down, down + face.shape[0]), slice(right, right + face.shape[1])
        same = (around[window] == face) & (face >= 0) & ~on_grid
        pixels.append(np.flatnonzero(same))
        others.append(index[window][same])
    pixel, other = np.concatenate(pixels), np.concatenate(others)
    count = np.bincount(pixel, minlength=face.size)
    means = coo_array((1 / count[pixel], (pixel, other)), shape=(face.size, face.size))
    return csr_array(means.tocsr() + diags_array((count == 0).astype(float)))
