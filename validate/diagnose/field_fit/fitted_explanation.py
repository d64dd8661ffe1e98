"""One form of a family of explanations, fitted to a residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from cboxlab.rendering.fitted_fields import IN_PLACE, Acts, ImageMaps, PictureCopy, WaveMap
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .field import FieldFit, NormalEquations, normal_equations
from .residual_data import ResidualData

if TYPE_CHECKING:
    from .family import Family

__all__ = ["Columns", "FittedExplanation", "change_dn", "equations_in_all_bands", "scaled"]

#: Changes (k, pixel) of the signal of one band in DN, by the index of the band.
Columns = Callable[[int], NDArray[Any] | csr_matrix]


@dataclass(frozen=True, eq=False)
class FittedExplanation:
    """One form of a family, fitted to a residual: a linear field with its coefficients."""

    #: Family of the form.
    family: Family
    #: The form in words, such as "rows in one band".
    form: str
    #: The fit of the coefficients.
    fit: FieldFit
    #: Changes of the signal by the images of the field.
    columns: Columns
    #: Quantity on which the field acts, see ``FittedField``.
    acts: Acts
    #: Maps of the field: over the image, or on surfaces. One map lies on several surfaces if they share a coefficient.
    maps: ImageMaps | tuple[WaveMap, ...]
    #: Name of the only surface on which the field acts; None where it acts on several or on none.
    surface: str | None = None
    #: Whether the field acts in one place of the image.
    local: bool = False
    #: Whether it is a pattern that rendering errors do not make: rows, columns, waves, lines, one band alone.
    sharp: bool = False
    #: Number of forms of this kind among which this one has the largest evidence.
    num_choices: int = 1
    #: Radius of an exchange of light with neighbours, px.
    radius: int = 1
    #: Direction of a streak or of a trail from the rows, downwards, degrees.
    angle_deg: float = 0.0
    #: Place of a copy of the picture.
    picture_copy: PictureCopy = IN_PLACE
    #: Highest count above dark of a field by levels, DN.
    most_dn: float = 1.0
    #: (band,) signal of an object in front, DN; None for other fields.
    radiance: NDArray[np.float64] | None = None
    #: (band,) relative change of reflectance where another paint of the scene covers a surface; None for other fields.
    paint_change: NDArray[np.float64] | None = None
    #: (band, y, x) signal that the maps multiply, of light reflected by a coat or by angle, DN; None for other fields.
    mirrored_dn: NDArray[np.floating] | None = None
    #: Part of the chi2 explained by effects that errors of their shapes may leave in a pattern of this form.
    effects_leave: float = 0.03

    @property
    def evidence(self) -> float:
        """2 ln of the evidence over noise alone, less the gain by choosing among several forms."""
        return self.fit.evidence - 2 * float(np.log(self.num_choices))


def equations_in_all_bands(data: ResidualData, columns: Columns) -> NormalEquations:
    """Normal equations of a field in all bands.

    Parameters
    ----------
    data
        Residual to be fitted.
    columns
        Changes of the signal by the images of the field, by the index of the band.

    Returns
    -------
    NormalEquations
        The equations of each band.
    """
    parts = [normal_equations(data, columns(band), band) for band in range(len(data.bands))]
    return NormalEquations(*(np.array(values) for values in zip(*parts, strict=True)))


def change_dn(data: ResidualData, explanation: FittedExplanation) -> NDArray[np.float64]:
    """Change of the signal by a fitted explanation.

    Parameters
    ----------
    data
        Residual that was fitted.
    explanation
        The fitted explanation.

    Returns
    -------
    NDArray
        (band, y, x) change, DN.
    """
    bands = range(len(data.bands))
    changes = [explanation.fit.coefficients[band] @ explanation.columns(band) for band in bands]
    return np.array(changes).reshape(-1, *data.shape)


def scaled(basis: NDArray[Any] | csr_matrix, image: NDArray[Any]) -> NDArray[Any] | csr_matrix:
    """Maps multiplied by an image.

    Parameters
    ----------
    basis
        (k, pixel) maps, dense or sparse.
    image
        (y, x) factors.

    Returns
    -------
    NDArray or csr_matrix
        (k, pixel) products in single precision, sparse where the maps are.
    """
    values = image.ravel().astype(np.float32)
    if isinstance(basis, csr_matrix):
        return basis.multiply(values[None, :]).tocsr()
    return basis.astype(np.float32) * values
