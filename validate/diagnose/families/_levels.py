"""One number for each band, constant over the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from ..field_fit import (
    Columns,
    FieldFit,
    NormalEquations,
    ResidualData,
    cross_validate,
    fit_result,
    solve_coefficients,
)

__all__ = ["EVEN", "fit_levels", "relative_levels"]

#: One map that is 1 everywhere.
EVEN = ImageMaps("cosines")


def relative_levels(data: ResidualData) -> Columns:
    """Changes of the signal by relative levels of the bands.

    Parameters
    ----------
    data
        Residual to be explained.

    Returns
    -------
    Columns
        (1, pixel) signal of a band, by its index.
    """

    def columns(band: int) -> NDArray[Any]:
        return data.signal[band].astype(np.float32).reshape(1, -1)

    return columns


def fit_levels(n: NormalEquations, shapes: NDArray[Any], more: float) -> FieldFit:
    """Fit of levels that are sums of given shapes over the bands.

    Parameters
    ----------
    n
        Normal equations of ``relative_levels``.
    shapes
        (band, q) shapes.
    more
        2 ln evidence from other observations, added.

    Returns
    -------
    FieldFit
        The fit; its coefficients are the levels (band, 1).
    """
    nuisance = n.c[:, :, 0]
    h = np.diag(n.a[:, 0, 0]) - nuisance @ nuisance.T
    trial_h = np.diag(n.trial_a[:, 0, 0])
    size = np.linalg.norm(shapes, axis=0)
    shapes = shapes / np.where(size > 0, size, 1)
    x, evidence, freedom, width = solve_coefficients(shapes.T @ h @ shapes, shapes.T @ n.b[:, 0])
    trial = cross_validate(shapes.T @ trial_h @ shapes, shapes.T @ n.trial_b[:, 0], width)
    return fit_result(n, (shapes @ x)[:, None], (shapes @ trial)[:, None], evidence + more, freedom)
