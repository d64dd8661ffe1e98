"""Covariance of rendering errors that pixels share: by band, face, and parts of a face.

An error that pixels share is not averaged away by their number. Counted as part of the covariance of the residual
(generalised least squares), it takes weight from what such errors can imitate and leaves the rest its full weight:
sharp or coloured changes of a hundredth of the noise show, smooth ones in all bands alike do not.

The covariance over that of independent noise is I + Z Z' + V V'. Z has one column for each cell of a face; the cells do
not overlap. V has few columns. The inverse square root of each part has a closed form.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

__all__ = ["PictureErrors", "cells_and_columns", "picture_errors", "sample_blocks"]

#: Relative standard deviation of the error that a cell of a face shares in all bands. Pictures of one box by two
#: independent simulators differ by 0.1 to 0.4 %, equally in all bands, over a tenth to a third of a face.
_CELL_ERROR = 0.0015

#: Relative standard deviation of the error that a region of a face shares in all bands: from the same two simulators.
_REGION_ERROR = 0.0015

#: Cells across and down the image, for errors of small extent.
_CELLS = 16

#: Regions across and down the image, for errors of large extent.
_REGIONS = 4

#: Samples whose products are computed at once, to bound the memory.
_SAMPLES_PER_BLOCK = 2**15

#: Fewest pixels of a region with an error of its size; the cells of smaller regions suffice.
_MIN_REGION_PIXELS = 20


@dataclass(frozen=True, eq=False)
class PictureErrors:
    """Shared rendering errors of n samples, ready for whitening."""

    #: (n,) number of each sample's cell.
    cell: NDArray[np.int32]
    #: (n,) standard deviation of the cell's error at each sample, over sigma.
    weight: NDArray[np.float32]
    #: (cells,) factor by which whitening shrinks the component along a cell's error.
    shrink: NDArray[np.float64]
    #: (n, k) orthonormal columns of the other errors, whitened by the cells.
    common: NDArray[np.float32]
    #: (k,) share of the component along each column that whitening subtracts, 0 to 1.
    part: NDArray[np.float64]

    def whitened(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vector over sigma times the inverse square root of the covariance.

        Products with ``common`` are in single precision: their errors of a few parts in a million lie along its
        columns, which whitening suppresses.

        Parameters
        ----------
        pixels
            (..., n) values over sigma.

        Returns
        -------
        NDArray
            (..., n) whitened values.
        """
        apart = np.apply_along_axis(self._by_cells, -1, pixels)
        blocks = sample_blocks(len(self.cell))
        parts = (apart[..., some].astype(np.float32) @ self.common[some] for some in blocks)
        along = (self.part * sum(parts, np.zeros(len(self.part)))).astype(np.float32)
        for some in blocks:
            apart[..., some] -= along @ self.common[some].T
        return apart

    def of_cells(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Likeliest errors of the cells in a vector over sigma, all other errors taken off.

        Parameters
        ----------
        pixels
            (n,) values over sigma.

        Returns
        -------
        NDArray
            (n,) over sigma.
        """
        amount = np.bincount(self.cell, self.weight * pixels, len(self.shrink)) / (1 + self._cell_squares)
        return np.asarray(self.weight * amount[self.cell])

    @property
    def volume_of_cells(self) -> float:
        """Logarithm of the determinant of the covariance by noise and cells over that by noise."""
        return float(np.log1p(self._cell_squares).sum())

    @property
    def _cell_squares(self) -> NDArray[np.float64]:
        """(cells,) variance by a cell's error along it, over that of noise."""
        return np.asarray(np.bincount(self.cell, self.weight.astype(float) ** 2, len(self.shrink)), float)

    def _by_cells(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vector (n,) whitened by the errors of cells alone."""
        sums = np.bincount(self.cell, self.weight * pixels, len(self.shrink))
        return np.asarray(pixels - self.weight * (self.shrink * sums)[self.cell])


def picture_errors(
    signal: NDArray, coverage: NDArray, used: NDArray[np.bool_], sigma: NDArray, others: Sequence[NDArray]
) -> PictureErrors:
    """Shared rendering errors of the samples of a picture.

    Parameters
    ----------
    signal
        (band, y, x) rendered signal, DN.
    coverage
        (y, x, face) share of each pixel that a face covers.
    used
        (band, y, x) True for the n samples.
    sigma
        (n,) standard deviation of the samples, DN.
    others
        One standard deviation of each further error, such as those of bands and faces: (n,) over sigma.

    Returns
    -------
    PictureErrors
        The errors, prepared for whitening.
    """
    rows, columns = np.indices(used.shape[1:])
    height, width = used.shape[1:]
    face = coverage.argmax(axis=-1)

    def parts_of_faces(across: int) -> NDArray[np.int64]:
        """(n,) numbers of the parts of faces that samples lie in."""
        number = (rows * across // height * across + columns * across // width) * coverage.shape[-1] + face
        of_samples = np.broadcast_to(number, used.shape)[used]
        return np.asarray(np.unique(of_samples, return_inverse=True)[1].reshape(-1))

    level = signal[used] / sigma
    region = parts_of_faces(_REGIONS)
    large = np.flatnonzero(np.bincount(region) >= _MIN_REGION_PIXELS * len(used))
    regions = (np.where(region == number, _REGION_ERROR * level, 0.0) for number in large)
    return cells_and_columns(
        parts_of_faces(_CELLS), _CELL_ERROR * level, chain(others, regions), len(others) + len(large)
    )


def cells_and_columns(cell: NDArray, weight: NDArray, columns: Iterable[NDArray], count: int) -> PictureErrors:
    """Errors of cells that do not overlap, and further errors.

    Parameters
    ----------
    cell
        (n,) number of each sample's cell, from 0.
    weight
        (n,) standard deviation of the cell's error at each sample, over sigma.
    columns
        One standard deviation of each further error: (n,) over sigma. They may be many, so none is kept.
    count
        Their number.

    Returns
    -------
    PictureErrors
        The errors, prepared for whitening.
    """
    squares = np.bincount(cell, weight**2)
    # (1 + s)^(-1/2) - 1 along the cell's unit vector, s its square
    shrink = (1 - 1 / np.sqrt(1 + squares)) / np.maximum(squares, 1e-300)
    cells = PictureErrors(
        cell.astype(np.int32),
        weight.astype(np.float32),
        shrink,
        np.zeros((len(cell), 0), np.float32),
        np.zeros(0),
    )
    common = np.empty((len(cell), count), np.float32)
    for column, other in zip(common.T, columns, strict=True):
        column[:] = cells.whitened(other)
    blocks = sample_blocks(len(cell))
    none = np.zeros((count, count))
    values, vectors = np.linalg.eigh(sum((common[some].T.astype(float) @ common[some] for some in blocks), none))
    independent = values > 1e-9 * max(values.max(initial=0.0), 1e-300)
    values, vectors = values[independent], vectors[:, independent]
    turn = vectors / np.sqrt(values)
    for some in blocks:  # in place: a second matrix of this size would double the memory
        common[some, : len(values)] = common[some] @ turn
    return PictureErrors(cells.cell, cells.weight, shrink, common[:, : len(values)], 1 - 1 / np.sqrt(1 + values))


def sample_blocks(count: int) -> list[slice]:
    """Slices of samples whose products are computed at once.

    Parameters
    ----------
    count
        Number of samples.

    Returns
    -------
    list of slice
        Of equal length but the last one.
    """
    return [slice(start, start + _SAMPLES_PER_BLOCK) for start in range(0, count, _SAMPLES_PER_BLOCK)]
