"""Columns of all nuisances of a capture, which fits of further causes marginalise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array

from ...predict import sample_blocks
from .model import LinearModel

__all__ = ["NuisanceColumns", "nuisance_columns"]


@dataclass(frozen=True, eq=False)
class NuisanceColumns:
    """Columns W of camera, lamp and shared errors.

    The information about whitened changes X is X^T X - (W^T X)^T (W^T X).
    """

    #: (band, y, x, m) camera and lamp, then shared errors; 0 where unused.
    picture: NDArray[np.float32]
    #: Number of the first columns that are camera and lamp.
    num_free: int
    #: (k, m - num_free) rows of the shared errors' columns that belong to the priors.
    of_priors: NDArray[np.float64]

    def marginalised(self, model: LinearModel, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """A residual without the errors that bands or faces share.

        Parameters
        ----------
        model
            Linear model of the capture.
        residual
            (n + 11,) projected, over sigma.

        Returns
        -------
        NDArray
            (n,) at the used samples.
        """
        bands = np.split(residual[: model.count], np.cumsum(model.used.sum(axis=(1, 2)))[:-1])

        def each() -> Iterator[tuple[NDArray[np.float64], NDArray[np.float32]]]:
            for band, picture, used in zip(bands, self.picture, model.used, strict=True):
                yield band, picture[used, self.num_free :]

        along = residual[model.count :] @ self.of_priors + sum(band @ columns for band, columns in each())
        return np.concatenate([band - columns @ along for band, columns in each()])


def nuisance_columns(model: LinearModel, errors: csr_array | None = None) -> NuisanceColumns:
    """Columns of a linear model's nuisances.

    Camera and lamp are projected out already. Errors shared by bands or faces have unit variance; the Woodbury identity
    marginalises over them.

    Parameters
    ----------
    model
        Linear model of the capture.
    errors
        (n, k) over sigma, errors that samples share, one standard deviation each; None: those of the model.

    Returns
    -------
    NuisanceColumns
        In single precision.
    """
    basis, blocks = model.basis, sample_blocks(len(model.basis))
    shared = csr_array(model.shared_errors) if errors is None else errors

    def rows_of(some: slice) -> NDArray[np.float32]:
        rows = shared[some].toarray()
        return np.pad(rows, ((0, len(basis[some]) - len(rows)), (0, 0)))

    along = sum((basis[some].T @ rows_of(some) for some in blocks), np.zeros((basis.shape[1], shared.shape[1])))
    products = np.eye(shared.shape[1])
    for some in blocks:
        apart = rows_of(some) - basis[some] @ along
        products += apart.T @ apart
    factor, rank = np.linalg.cholesky(products), basis.shape[1]
    picture = np.zeros((model.used.size, rank + shared.shape[1]), np.float32)
    of_priors, index = list[NDArray[np.float64]](), np.flatnonzero(model.used)
    for some in blocks:
        rows = solve_triangular(factor, (rows_of(some) - basis[some] @ along).T, lower=True).T
        inside = index[some]  # none in the rows of the priors
        picture[inside, :rank], picture[inside, rank:] = basis[some][: len(inside)], rows[: len(inside)]
        of_priors.append(rows[len(inside) :].copy())  # a view would keep all rows, twice as large as the picture
    return NuisanceColumns(picture.reshape(*model.used.shape, -1), rank, np.concatenate(of_priors))
