"""CIE 1931 standard observer: colour-matching functions, luminous efficacy, chromaticity."""

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
    """CIE 1931 2-degree xbar, ybar, zbar (tables of colour-science).

    The table has 360 to 830 nm (OBSERVER_RANGE_NM) by 1 nm. It is linear between its samples and 0 beyond its ends.

    Parameters
    ----------
    wavelength_nm
        (n,) wavelengths, nm; WAVELENGTH_NM where left out.

    Returns
    -------
    NDArray
        (3, n) values of the three functions.
    """
    from colour import MSDS_CMFS  # slow to import, and only needed here

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    table, at = np.asarray(observer.values, float).T, np.asarray(wavelength_nm, float)
    return np.stack([np.interp(at, observer.wavelengths, row, left=0.0, right=0.0) for row in table])


def chromaticity(xyz: ArrayLike) -> NDArray[np.float64]:
    """CIE 1931 chromaticity coordinates x, y of tristimulus values.

    Parameters
    ----------
    xyz
        (..., 3) X, Y, Z in any common unit.

    Returns
    -------
    NDArray
        (..., 2) x and y; NaN where X + Y + Z is not above 0.
    """
    values = np.asarray(xyz, float)
    total = values.sum(axis=-1, keepdims=True)
    return values[..., :2] / np.where(total > 0, total, np.nan)
