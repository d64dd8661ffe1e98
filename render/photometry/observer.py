"""Tristimulus values of spectra over whatever wavelengths a cube has."""

from __future__ import annotations

import numpy as np
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY
from numpy.typing import NDArray

from ..files import xyz_weights

__all__ = ["tristimulus_weights", "why_no_luminance"]

#: Wavelengths that have to be covered, nm: 99.7 % of the luminance of light of equal energy per nm.
FIRST_NM, LAST_NM = 400.0, 700.0

#: Fewest wavelengths over which luminance is integrated.
FEWEST = 10


def why_no_luminance(wavelength_nm: NDArray[np.float64]) -> str | None:
    """A sentence where wavelengths (w,), ascending, do not suffice for luminances, else None."""
    first, last, count = wavelength_nm[0], wavelength_nm[-1], len(wavelength_nm)
    if first <= FIRST_NM and last >= LAST_NM and count >= FEWEST:
        return None
    return (
        f"no luminances: {count} wavelength{'s' * (count != 1)} from {first:g} to {last:g} nm; they take {FEWEST} or "
        f"more that reach from {FIRST_NM:g} to {LAST_NM:g} nm"
    )


def tristimulus_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w, 3) weights: radiance (W m^-2 sr^-1 nm^-1) times these is X, Y, Z, Y the luminance in cd m^-2.

    The same weights make X, Y, Z of irradiance (W m^-2 nm^-1), Y the illuminance in lx; see ``xyz_weights``.
    """
    return LUMINOUS_EFFICACY * xyz_weights(wavelength_nm)
