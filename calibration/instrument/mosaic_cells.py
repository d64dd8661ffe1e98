"""Means of the pixels that each band sees in one repeat of a mosaic.

A pixel behind a mosaic shows one channel, so XYZ needs several pixels. All pixels of a repeat (a cell) get the means
of the bands' pixels in it: the same for measured and rendered signals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["CellMeans", "cell_means", "interpolated_channel", "one_pixel_of_each_cell"]


@dataclass(frozen=True, eq=False)
class CellMeans:
    """Means over the cells of a mosaic, given to all pixels of a cell."""

    #: (band, y, x) mean signal of a band's used pixels in the cell; 0 where there are none.
    signal: NDArray[np.float64]
    #: (band, y, x) its variance; 0 where there are none.
    variance: NDArray[np.float64]
    #: (y, x) True where every band has a used pixel in the cell.
    complete: NDArray[np.bool_]


def _cells(shape: tuple[int, int], cell: tuple[int, int]) -> NDArray[np.int64]:
    """(y, x) number of the cell of each pixel, counted from the upper left one."""
    v, u = np.indices(shape)
    return np.asarray(v // cell[0] * -(-shape[1] // cell[1]) + u // cell[1], np.int64)


def cell_means(signal: ArrayLike, variance: ArrayLike, used: ArrayLike, cell: tuple[int, int]) -> CellMeans:
    """Means of each band's used pixels in every cell.

    The noise is independent between pixels, so the variance of a mean of n pixels is their sum over n^2.

    Parameters
    ----------
    signal
        (band, y, x) signal.
    variance
        (band, y, x) its variance.
    used
        (band, y, x) True for the pixels that the band sees and that are not masked.
    cell
        (height, width) of one repeat of the mosaic, px; the first starts at the upper left pixel.

    Returns
    -------
    CellMeans
        In the shape of the images.
    """
    values, noise = np.asarray(signal, np.float64), np.asarray(variance, np.float64)
    counted: NDArray[np.bool_] = np.asarray(used, np.bool_)
    cells = _cells((values.shape[1], values.shape[2]), cell)
    count = int(cells.max()) + 1
    numbers = [cells[counted[band]] for band in range(len(counted))]
    pixels = np.stack([np.bincount(number, minlength=count) for number in numbers])
    divisor = np.maximum(pixels, 1)
    sums = [
        np.stack([np.bincount(number, images[band][counted[band]], count) for band, number in enumerate(numbers)])
        for images in (values, noise)
    ]
    return CellMeans((sums[0] / divisor)[:, cells], (sums[1] / divisor**2)[:, cells], (pixels.min(axis=0) > 0)[cells])


def one_pixel_of_each_cell(where: NDArray[np.bool_], cell: tuple[int, int]) -> NDArray[np.bool_]:
    """First pixel of a region in each cell: values of whole cells then count once.

    Parameters
    ----------
    where
        (y, x) True in the region.
    cell
        (height, width) of one repeat of the mosaic, px.

    Returns
    -------
    NDArray
        (y, x) True for one pixel of each cell with a pixel in the region.
    """
    inside = np.flatnonzero(where)
    _, first = np.unique(_cells((where.shape[0], where.shape[1]), cell).ravel()[inside], return_index=True)
    single = np.zeros(where.size, bool)
    single[inside[first]] = True
    return single.reshape(where.shape)


def interpolated_channel(
    image: NDArray[np.float64], in_channel: NDArray[np.bool_], cell: tuple[int, int]
) -> NDArray[np.float64]:
    """Image of one channel with its gaps filled from neighbours, for display and edge detection.

    The weights fall linearly to 0 at the distance of one cell in either direction: bilinear behind a Bayer mosaic.

    Parameters
    ----------
    image
        (y, x) signal.
    in_channel
        (y, x) True for the pixels of the channel.
    cell
        (height, width) of one repeat of the mosaic, px.

    Returns
    -------
    NDArray
        (y, x) the image itself in the channel; NaN where no pixel of the channel is near.
    """
    sums = []
    for values in (np.where(in_channel, image, 0.0), in_channel.astype(float)):
        for axis, size in enumerate(cell):
            weights = size - np.abs(np.arange(1 - size, size))
            values = np.apply_along_axis(np.convolve, axis, np.pad(values, _margin(axis, size)), weights, "valid")
        sums.append(values)
    filled = np.divide(sums[0], sums[1], out=np.full(image.shape, np.nan), where=sums[1] > 0)
    return np.where(in_channel, image, filled)


def _margin(axis: int, size: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Zeros added before and after an axis for weights of ``2 size - 1`` pixels."""
    margin, none = (size - 1, size - 1), (0, 0)
    return (margin, none) if axis == 0 else (none, margin)
