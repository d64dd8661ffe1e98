"""Tristimulus values of spectra over whatever wavelengths a cube has."""

from __future__ import annotations

import numpy as np
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY
from numpy.typing import NDArray

from ..files import xyz_weights

__all__ = ["tristimulus_weights", "why_no_luminance"]

#: Shortest wavelength that has to be covered, nm; with LAST_NM 99.7 % of the luminance of equal energy per nm.
FIRST_NM = 400.0

#: Longest wavelength that has to be covered, nm.
LAST_NM = 700.0

#: Fewest wavelengths over which luminance is integrated.
FEWEST = 10


def why_no_luminance(wavelength_nm: NDArray[np.float64]) -> str | None:
    """Reason why wavelengths do not suffice for luminances.

    Parameters
    ----------
    wavelength_nm
        (w,) wavelengths, ascending, nm.

    Returns
    -------
    str or None
        A sentence; None where they suffice.
    """
    first, last, count = wavelength_nm[0], wavelength_nm[-1], len(wavelength_nm)
    if first <= FIRST_NM and last >= LAST_NM and count >= FEWEST:
        return None
    return (
        f"no luminances: {count} wavelength{'s' * (count != 1)} from {first:g} to {last:g} nm. Luminances need "
        f"{FEWEST} or more, from {FIRST_NM:g} to {LAST_NM:g} nm"
    )


def tristimulus_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights from spectra to X, Y, Z, see ``xyz_weights``.

    Parameters
    ----------
    wavelength_nm
        (w,) wavelengths, nm.

    Returns
    -------
    NDArray
        (w, 3) weights. Radiance (W m^-2 sr^-1 nm^-1) times these is X, Y, Z with Y in cd m^-2; irradiance
        (W m^-2 nm^-1) times these has Y in lx.
    """
    return LUMINOUS_EFFICACY * xyz_weights(wavelength_nm)
