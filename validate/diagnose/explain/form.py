"""One way in which a family could explain the excess, fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps, WaveMap
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess
from .field import FieldFit, Normal, normal

__all__ = ["Columns", "Form", "changed", "equations", "scaled"]

#: Changes (k, pixel) in DN of one band, by its index.
Columns = Callable[[int], NDArray[Any] | csr_matrix]


@dataclass(frozen=True, eq=False)
class Form:
    """family : one of FAMILIES. words : what it is. surface : on which it acts alone, or None. local : whether it acts
    in one place of the picture. sharp : whether it is a pattern that errors of the rendered picture do not make: rows,
    columns, waves, lines, one band alone. choices : number of such forms among which this one is the best.
    acts, maps : what it acts on (see ``fields.FittedField``), and by which maps; one map on several surfaces where it
    has one coefficient. radius : of exchanges with neighbours, px. angle_deg : of a streak.
    most_dn : of levels. radiance : (band,) of a thing in front.
    covered : (band,) relative change of the reflectance where another paint of the scene covers a surface.
    mirrored : (band, y, x) DN that the maps are factors of, of light that a surface mirrors or reflects by the angle.
    effects_leave : part of the chi2 that effects explain which errors of their shapes may leave in such a pattern.
    """

    family: str
    words: str
    fit: FieldFit
    columns: Columns
    acts: Acts
    maps: ImageMaps | tuple[WaveMap, ...]
    surface: str | None = None
    local: bool = False
    sharp: bool = False
    choices: int = 1
    radius: int = 1
    angle_deg: float = 0.0
    most_dn: float = 1.0
    radiance: NDArray[np.float64] | None = None
    covered: NDArray[np.float64] | None = None
    mirrored: NDArray[np.floating] | None = None
    effects_leave: float = 0.03

    @property
    def evidence(self) -> float:
        """2 ln of the evidence over that of noise alone, less what choosing among several forms gives."""
        return self.fit.evidence - 2 * float(np.log(self.choices))


def equations(excess: Excess, columns: Columns) -> Normal:
    """Normal equations of columns in all bands."""
    parts = [normal(excess, columns(band), band) for band in range(len(excess.bands))]
    return Normal(*(np.array(values) for values in zip(*parts, strict=True)))


def changed(excess: Excess, form: Form) -> NDArray[np.float64]:
    """(band, y, x) DN that a form changes."""
    found = [form.fit.coefficients[band] @ form.columns(band) for band in range(len(excess.bands))]
    return np.array(found).reshape(-1, *excess.shape)


def scaled(basis: NDArray[Any] | csr_matrix, image: NDArray[Any]) -> NDArray[Any] | csr_matrix:
    """A basis (k, pixel) times an image (y, x)."""
    values = image.ravel().astype(np.float32)
    if isinstance(basis, csr_matrix):
        return basis.multiply(values[None, :]).tocsr()
    return basis.astype(np.float32) * values
