"""The CIE 1931 standard observer: colour-matching functions, luminous efficacy, chromaticity."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import ArrayLike, NDArray

__all__ = ["LUMINOUS_EFFICACY", "OBSERVER_RANGE_NM", "chromaticity", "colour_matching_functions"]

#: Luminous efficacy of monochromatic light at 555 nm, lm/W.
LUMINOUS_EFFICACY = 683.0
#: Ends of the CIE's table of the colour-matching functions, nm.
OBSERVER_RANGE_NM = (360.0, 830.0)


def colour_matching_functions(wavelength_nm: ArrayLike = WAVELENGTH_NM) -> NDArray[np.float64]:
    """(3, n) CIE 1931 2-degree xbar, ybar, zbar, by default on WAVELENGTH_NM (tables of colour-science).

    The table has 360 to 830 nm (OBSERVER_RANGE_NM) by 1 nm. It is linear between its samples and 0 beyond its ends.
    """
    from colour import MSDS_CMFS  # slow to import, and only needed here

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    table, at = np.asarray(observer.values, float).T, np.asarray(wavelength_nm, float)
    return np.stack([np.interp(at, observer.wavelengths, row, left=0.0, right=0.0) for row in table])


def chromaticity(xyz: ArrayLike) -> NDArray[np.float64]:
    """(..., 2) CIE 1931 x, y of X, Y, Z (..., 3); NaN where their sum is not above 0."""
    values = np.asarray(xyz, float)
    whole = values.sum(axis=-1, keepdims=True)
    return values[..., :2] / np.where(whole > 0, whole, np.nan)
