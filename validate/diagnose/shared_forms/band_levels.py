"""One number for each band, constant over the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
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
    equations_in_all_bands,
    fit_result,
    solve_coefficients,
)

__all__ = ["EVEN", "LevelEquations", "fit_levels", "level_equations", "relative_levels"]

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


@dataclass(frozen=True, eq=False)
class LevelEquations:
    """Normal equations of levels of the bands, to fit them and to test them."""

    #: Equations with errors of bands marginalised, which decide on size and evidence.
    fitted: NormalEquations
    #: The same of the residual as it is. Levels of bands and errors of bands are alike: only this one has the levels
    #: in the pixels held out.
    tested: NormalEquations


def level_equations(data: ResidualData) -> LevelEquations:
    """Normal equations of relative levels.

    Parameters
    ----------
    data
        Residual to be explained.

    Returns
    -------
    LevelEquations
        For `fit_levels`.
    """
    columns = relative_levels(data)
    plain = replace(data, marginal_residual=data.residual.astype(float))
    return LevelEquations(equations_in_all_bands(data, columns), equations_in_all_bands(plain, columns))


def fit_levels(equations: LevelEquations, shapes: NDArray[Any], more: float = 0.0) -> FieldFit:
    """Fit of levels that are sums of given shapes over the bands.

    Parameters
    ----------
    equations
        Equations of `level_equations`.
    shapes
        (band, q) shapes.
    more
        2 ln evidence from other observations, added.

    Returns
    -------
    FieldFit
        The fit; its coefficients are the levels (band, 1).
    """
    n, tested = equations.fitted, equations.tested
    nuisance = n.c[:, :, 0]
    h = np.diag(n.a[:, 0, 0]) - nuisance @ nuisance.T
    trial_h = np.diag(n.trial_a[:, 0, 0])
    size = np.linalg.norm(shapes, axis=0)
    shapes = shapes / np.where(size > 0, size, 1)
    x, evidence, freedom, width = solve_coefficients(shapes.T @ h @ shapes, shapes.T @ n.b[:, 0])
    trial = (shapes @ cross_validate(shapes.T @ trial_h @ shapes, shapes.T @ tested.trial_b[:, 0], width))[:, None]
    fit = fit_result(n, (shapes @ x)[:, None], trial, evidence + more, freedom)
    return replace(fit, heldout=fit_result(tested, fit.coefficients, trial, evidence, freedom).heldout)
