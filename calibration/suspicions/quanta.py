"""Spectra in quanta where energy is meant: bands are then off by a power of the wavelength."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray
from scipy.stats import theilslopes

from ..capture import BandTable, Capture

__all__ = ["centre_nm", "power_law"]

#: Largest distance of the power from 1 or -1, and of four fifths of the logarithms from the line.
_NEAR, _STRAIGHT = 0.2, 0.04


def centre_nm(capture: Capture, band: BandTable) -> float:
    """The mean wavelength of a band's transmittance, nm; NaN if it is not stated."""
    if band.transmittance is None:
        return float("nan")
    transmittance = capture.light(band.transmittance).at(WAVELENGTH_NM)
    return float(np.sum(transmittance * WAVELENGTH_NM) / max(np.sum(transmittance), 1e-300))


def power_law(wavelength_nm: NDArray[np.float64], ratios: NDArray[np.float64]) -> int | None:
    """The power of the wavelength, 1 or -1, that ratios (n,) follow; None if they follow neither.

    Robust against one band in five (a leak, a wrong exposure).
    """
    good = np.isfinite(wavelength_nm) & np.isfinite(ratios) & (ratios > 0)
    if np.count_nonzero(good) < 4 or np.ptp(wavelength_nm[good]) == 0:
        return None
    x, y = np.log(wavelength_nm[good]), np.log(ratios[good])
    slope, offset, *_ = theilslopes(y, x)
    near = abs(abs(slope) - 1) < _NEAR and np.quantile(np.abs(y - slope * x - offset), 0.8) < _STRAIGHT
    return int(np.sign(slope)) if near else None
