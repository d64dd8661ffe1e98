"""Goodness of fit of an effect in the very places, bands and directions where it acts.

A true effect has one amplitude. What only resembles the cause fits one place better than another: of a blur along a
line, a round one explains too much at edges along it and too little at edges across.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import ResidualData
from .noise import noise_level

__all__ = ["misfit"]

#: Squares along a side of the picture in which an amplitude may differ, in each band.
_SQUARES = 8

#: Part of an effect's gain that errors of its shape may leave in single squares: an error of a seventh each.
_LEFT_BY_SHAPES = 0.02


def misfit(data: ResidualData, shape: NDArray[np.float64], together: NDArray[np.float64], gain: float) -> float:
    """Size of what an effect leaves where another amplitude would fit each square and band.

    The amplitudes differ from one with a normal prior of width 1. Camera, lamp and errors that many samples share, such
    as flaws of the base, are marginalised.

    Parameters
    ----------
    data
        Residual without the effect, with its nuisances.
    shape
        (n,) change by the effect over sigma.
    together
        (n,) residual with the effect, over sigma.
    gain
        Chi2 that the effect explains.

    Returns
    -------
    float
        Chi2 that different amplitudes explain beyond noise, over what noise and errors of the shape make: about 0 for
        a true effect, at most 1 in most cases.
    """
    rows, columns = (
        indices * _SQUARES // size for indices, size in zip(np.indices(data.shape), data.shape, strict=True)
    )
    bands = np.arange(len(data.bands))[:, None, None]
    squares = np.broadcast_to((bands * _SQUARES + rows) * _SQUARES + columns, data.used.shape)[data.used]
    # (square, sample) the change in each square
    size = len(data.bands) * _SQUARES**2, shape.size
    parts = csr_matrix((shape.astype(np.float32), (squares, np.arange(shape.size))), size)
    nuisances = data.nuisances[data.used]  # single precision, as they are large
    along = np.asarray(parts @ nuisances, float)
    information = np.diag(np.bincount(squares, shape**2, size[0])) - along @ along.T
    product = np.bincount(squares, shape * together, size[0]) - along @ (together.astype(np.float32) @ nuisances)
    narrowed = np.linalg.inv(information + np.eye(len(information)))
    by_noise = noise_level(data.residual, data.used) * float(np.trace(narrowed @ information))
    beyond = float(product @ narrowed @ product) - by_noise
    return max(beyond, 0.0) / (_LEFT_BY_SHAPES * max(gain, 0.0) + np.sqrt(2 * max(by_noise, 1.0)))
