"""Errors of the picture itself that pixels share, as a covariance: of bands, faces, regions and cells of faces.

An error that pixels share is not averaged away by their number. Counted as part of the covariance of the residual
(generalised least squares), it takes weight from what such errors can imitate and leaves the rest its full weight:
sharp or coloured changes of a hundredth of the noise show, smooth ones in all bands alike do not.

The covariance over that of independent noise is I + Z Z' + V V', with one column of Z for each cell of a face (they do
not overlap) and few columns V; its inverse square root is known in closed form for each part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PictureErrors", "picture_errors"]

#: Relative standard deviations of errors that a cell of a face shares in all bands, and a region of a face. Pictures of
#: one box by two independent simulators differ so: 0.1 to 0.4 %, alike in all bands, over a tenth to a third of a face.
_CELL_ERROR, _REGION_ERROR = 0.0015, 0.0015

#: Cells and regions of the image across and down.
_CELLS, _REGIONS = 16, 4

#: Samples whose products are taken at once.
_TOGETHER = 2**15

#: A region with fewer pixels is left to its cells.
_LEAST_PIXELS = 20


@dataclass(frozen=True, eq=False)
class PictureErrors:
    """cell : (n,) number of a sample's cell. weight : (n,) a standard deviation of the cell's error, over sigma.
    shrink : (cells,) see ``whitened``. common : (n, k) orthonormal columns of the other errors, whitened by cells.
    part : (k,) what whitening takes off along each."""

    cell: NDArray[np.int32]
    weight: NDArray[np.float32]
    shrink: NDArray[np.float64]
    common: NDArray[np.float32]
    part: NDArray[np.float64]

    def whitened(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """A vector (n,) over sigma, times the inverse square root of the covariance that these errors make of I.

        Products with ``common`` are in single precision: the few parts in a million that they are off are off along its
        own columns, of which little is left.
        """
        apart = self._by_cells(pixels)
        blocks = _blocks(len(apart))
        parts = (self.common[some].T @ apart[some].astype(np.float32) for some in blocks)
        along = (self.part * sum(parts, np.zeros(len(self.part)))).astype(np.float32)
        for some in blocks:
            apart[some] -= self.common[some] @ along
        return apart

    def _by_cells(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        sums = np.bincount(self.cell, self.weight * pixels, len(self.shrink))
        return np.asarray(pixels - self.weight * (self.shrink * sums)[self.cell])


def picture_errors(
    signal: NDArray, coverage: NDArray, used: NDArray[np.bool_], sigma: NDArray, others: Sequence[NDArray]
) -> PictureErrors:
    """signal : (band, y, x) DN. coverage : (y, x, face). used : (band, y, x). sigma : (n,) DN.

    others : (n,) over sigma each, one standard deviation of further errors, such as those of bands and faces.
    """
    rows, columns = np.indices(used.shape[1:])
    height, width = used.shape[1:]
    face = coverage.argmax(axis=-1)

    def places(across: int) -> NDArray[np.int64]:
        """(n,) numbers of the parts of faces that samples lie in."""
        number = (rows * across // height * across + columns * across // width) * coverage.shape[-1] + face
        there = np.broadcast_to(number, used.shape)[used]
        return np.asarray(np.unique(there, return_inverse=True)[1].reshape(-1))

    level = signal[used] / sigma
    cell = places(_CELLS)
    weight = _CELL_ERROR * level
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
    region = places(_REGIONS)
    large = np.flatnonzero(np.bincount(region) >= _LEAST_PIXELS * len(used))
    common = np.empty((len(cell), len(others) + len(large)), np.float32)
    for column, other in zip(common.T, others, strict=False):
        column[:] = cells.whitened(other)
    for column, number in zip(common.T[len(others) :], large, strict=True):
        column[:] = cells.whitened(np.where(region == number, _REGION_ERROR * level, 0.0))
    blocks = _blocks(len(cell))
    none = np.zeros((common.shape[1], common.shape[1]))
    values, vectors = np.linalg.eigh(sum((common[some].T.astype(float) @ common[some] for some in blocks), none))
    seen = values > 1e-9 * max(values.max(initial=0.0), 1e-300)
    values, vectors = values[seen], vectors[:, seen]
    orthonormal = np.empty((len(cell), len(values)), np.float32)
    for some in blocks:
        orthonormal[some] = common[some] @ (vectors / np.sqrt(values))
    return PictureErrors(cells.cell, cells.weight, shrink, orthonormal, 1 - 1 / np.sqrt(1 + values))


def _blocks(count: int) -> list[slice]:
    """Parts of the samples."""
    return [slice(start, start + _TOGETHER) for start in range(0, count, _TOGETHER)]
