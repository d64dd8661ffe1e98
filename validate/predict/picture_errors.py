"""Covariance of rendering errors that pixels share: by band, face, and parts of a face.

An error that pixels share is not averaged away by their number. Counted as part of the covariance of the residual
(generalised least squares), it takes weight from what such errors can imitate and leaves the rest its full weight:
sharp or coloured changes of a hundredth of the noise show, smooth ones in all bands alike do not.

The covariance over that of independent noise is I + Z Z' + V V'. Z has one column for each cell of a face; the cells do
not overlap. V has few columns. The inverse square root of each part has a closed form.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array

__all__ = ["PictureErrors", "errors_of_cells", "picture_errors", "sample_blocks", "sparse_columns", "squares_of"]

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
    #: (n, k) columns of the other errors, whitened by the cells; 0 in most samples.
    columns: csr_array
    #: (k, k) multiples of products with the columns that whitening subtracts.
    inner: NDArray[np.float64]

    def whitened(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vector over sigma times the inverse square root of the covariance.

        Parameters
        ----------
        pixels
            (..., n) values over sigma.

        Returns
        -------
        NDArray
            (..., n) whitened values.
        """
        apart = self.by_cells(pixels.T)
        return np.asarray(apart - self.columns @ (self.inner @ (self.columns.T @ apart))).T

    def with_columns(
        self, columns: csr_array, width: NDArray[np.float64], products: NDArray[np.float64]
    ) -> PictureErrors:
        """The errors of cells with further errors.

        Parameters
        ----------
        columns
            (n, k) further errors over sigma, whitened by the cells.
        width
            (k,) standard deviations, in the columns.
        products
            (k, k) products of the columns, see `squares_of`.

        Returns
        -------
        PictureErrors
            The errors, prepared for whitening.
        """
        values, vectors = np.linalg.eigh(width[:, None] * products * width)
        root = np.sqrt(1 + np.maximum(values, 0.0))
        turn = width[:, None] * vectors
        # (1 - 1 / root) / (root^2 - 1), which columns that repeat one another do not disturb
        return replace(self, columns=columns, inner=turn / (root * (1 + root)) @ turn.T)

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

    @cached_property
    def _cells(self) -> csr_array:
        """(n, cells) error of each cell at each sample."""
        count = len(self.cell)
        ends = np.arange(count + 1, dtype=np.int32)
        return csr_array((self.weight, self.cell, ends), shape=(count, len(self.shrink)))

    def by_cells(self, pixels: Any) -> Any:
        """Vectors over sigma whitened by the errors of cells alone.

        Parameters
        ----------
        pixels
            (n, ...) values over sigma, dense or sparse.

        Returns
        -------
        NDArray or csr_array
            (n, ...) whitened values, as dense or sparse as the given ones.
        """
        return pixels - self._cells @ (diags_array(self.shrink.astype(np.float32)) @ (self._cells.T @ pixels))


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
    cells = errors_of_cells(parts_of_faces(_CELLS), _CELL_ERROR * level)
    columns = cells.by_cells(sparse_columns(chain(others, regions), len(sigma)).tocsr())
    return cells.with_columns(columns, np.ones(columns.shape[1]), squares_of(columns))


def errors_of_cells(cell: NDArray, weight: NDArray) -> PictureErrors:
    """Errors of cells that do not overlap.

    Parameters
    ----------
    cell
        (n,) number of each sample's cell, from 0.
    weight
        (n,) standard deviation of the cell's error at each sample, over sigma.

    Returns
    -------
    PictureErrors
        Without further errors.
    """
    squares = np.bincount(cell, weight**2)
    # (1 + s)^(-1/2) - 1 along the cell's unit vector, s its square
    shrink = (1 - 1 / np.sqrt(1 + squares)) / np.maximum(squares, 1e-300)
    none = csr_array((len(cell), 0), dtype=np.float32)
    return PictureErrors(cell.astype(np.int32), weight.astype(np.float32), shrink, none, np.zeros((0, 0)))


def sparse_columns(columns: Iterable[NDArray], count: int) -> csc_array:
    """Columns that are 0 in most samples.

    Parameters
    ----------
    columns
        (n,) each. They may be many, so none is kept.
    count
        Number n of samples.

    Returns
    -------
    csc_array
        (n, k) in single precision.
    """
    rows, values = [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
    for column in columns:
        rows.append(np.flatnonzero(column).astype(np.int32))
        values.append(column[rows[-1]].astype(np.float32))
    ends = np.cumsum([len(each) for each in rows], dtype=np.int32)
    return csc_array((np.concatenate(values), np.concatenate(rows), ends), shape=(count, len(ends) - 1))


def squares_of(columns: csr_array) -> NDArray[np.float64]:
    """Products of columns with one another.

    Parameters
    ----------
    columns
        (n, k) columns.

    Returns
    -------
    NDArray
        (k, k) products, in double precision.
    """
    products = np.zeros((columns.shape[1],) * 2)
    for some in sample_blocks(columns.shape[0]):
        block = columns[some].toarray().astype(float)
        products += block.T @ block
    return products


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
