"""Traced pixels of a large picture, which stand for their neighbours on the same face.

Light by a lobe of 0.03 rad or wider varies little from pixel to pixel of one face: 0.03 rad are eleven pixels of 256
across the box, and three of the grid that is traced. Rays are traced besides for pixels that see several faces, and
where the lamps' light changes quickly: a coat shows the edges of shadows as sharply as the paint below it.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array

__all__ = ["fewer_rays", "grid_step", "spreading"]

#: Rows and columns of traced pixels on the grid: in a larger picture fewer rays of each pixel say as much.
_GRID = 64

#: Relative error of the light between pixels of the grid above which a pixel is traced. At 128 x 128 pixels the mean
#: square error of four coats is 0.69 to 0.79 times that of tracing all pixels, since means of neighbours have less
#: noise. With 0.1 their change would be 1 % too small.
_MAX_LIGHT_ERROR = 0.05


def grid_step(pixels: int) -> int:
    """Distance of the rows and columns of traced pixels.

    Parameters
    ----------
    pixels
        Number of pixels of the picture.

    Returns
    -------
    int
        In pixels; 1 traces all.
    """
    return max(1, round(float(np.sqrt(pixels)) / _GRID))


def fewer_rays(rays: int, pixels: int) -> int:
    """Rays of each traced pixel in a picture whose grid has a larger step than two pixels.

    Parameters
    ----------
    rays
        Rays in a smaller picture.
    pixels
        Number of pixels of the picture.

    Returns
    -------
    int
        At least 1. Together they are as many rays of a surface as before.
    """
    return max(1, 2 * rays // max(2, grid_step(pixels)))


def spreading(face: NDArray[np.int64], light: NDArray[np.floating], step: int) -> csr_array:
    """Weights by which traced pixels stand for all.

    Parameters
    ----------
    face
        (y, x) index of the only face that a pixel sees, -1 for several or none.
    light
        (y, x) light of the lamps that arrives there, in any unit.
    step
        Distance of the grid's rows and columns, px.

    Returns
    -------
    csr_array
        (pixel, pixel) weights, each row's sum 1: linear in both directions between the pixels of the grid that see the
        same face. Traced pixels have 1 on the diagonal, the others 0.
    """
    rows, columns = np.indices(face.shape)
    index = np.arange(face.size).reshape(face.shape)
    pixels, others, weights = [], [], []
    for corner in product((0, step), repeat=2):
        row, column = rows // step * step + corner[0], columns // step * step + corner[1]
        weight = (1 - np.abs(rows - row) / step) * (1 - np.abs(columns - column) / step)
        inside = (weight > 0) & (face >= 0) & (row < face.shape[0]) & (column < face.shape[1])
        other = index[np.where(inside, row, 0), np.where(inside, column, 0)]
        same = inside & (face.flat[other] == face)
        pixels.append(index[same])
        others.append(other[same])
        weights.append(weight[same])
    pixel, other, each = np.concatenate(pixels), np.concatenate(others), np.concatenate(weights)
    total = np.bincount(pixel, each, face.size)
    means = coo_array((each / total[pixel], (pixel, other)), shape=(face.size, face.size)).tocsr()
    values = light.ravel()
    traced = (total == 0) | (np.abs(means @ values - values) > _MAX_LIGHT_ERROR * values)
    return csr_array(diags_array((~traced).astype(float)) @ means + diags_array(traced.astype(float)))
