"""Checks of spectra: gaps, unit of the wavelengths, range of the values.

Reflectances lie between 0 and 1, radiances are not negative.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.errors import InputError

from .spectra import Spectrum

__all__ = ["LARGEST_STEP", "radiance_faults", "reflectance_faults", "table_faults"]

#: Longest wavelength, nm, below which a table is in another unit: visible light in µm is below 1.
_SHORTEST_NM = 100.0
#: Step above which a table has a gap, in units of its median step: one missing row makes a step of 2.
LARGEST_STEP = 3.0


def table_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """Faults of the wavelengths of a table: another unit than nm, or gaps.

    A gap is a step above three times the median step, too wide to interpolate over.

    Parameters
    ----------
    spectrum
        The table.
    where
        File and key for the faults.

    Returns
    -------
    list[InputError]
        The faults; empty for a good table.
    """
    first, last = spectrum.wavelength_nm[[0, -1]]
    if last < _SHORTEST_NM:
        extent = f"wavelengths from {first:g} to {last:g}"
        return [InputError(where, extent, "wavelengths in nm", "multiply by 1000 if the table is in µm")]
    steps = np.diff(spectrum.wavelength_nm)
    if steps.size == 0:
        return []
    median = float(np.median(steps))
    return [
        InputError(
            where,
            f"a gap in the table from {spectrum.wavelength_nm[i]:g} to {spectrum.wavelength_nm[i + 1]:g} nm",
            f"steps up to {LARGEST_STEP * median:g} nm, {LARGEST_STEP:g} times the usual {median:g} nm",
            "fill in the missing rows",
        )
        for i in np.flatnonzero(steps > LARGEST_STEP * median)
    ]


def reflectance_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """Faults of a reflectance: those of its wavelengths, and the first value outside 0 to 1.

    Parameters
    ----------
    spectrum
        The table.
    where
        File and key for the faults.

    Returns
    -------
    list[InputError]
        The faults; empty for a good table.
    """
    faults = table_faults(spectrum, where)
    outside = np.flatnonzero((spectrum.values < 0) | (spectrum.values > 1))
    if outside.size:
        value, wavelength = spectrum.values[outside[0]], spectrum.wavelength_nm[outside[0]]
        hint = "divide by 100 if the table is in percent" if 1 < spectrum.values.max() <= 100 else ""
        faults.append(InputError(where, f"reflectance {value:g} at {wavelength:g} nm", "values from 0 to 1", hint))
    return faults


def radiance_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """Faults of a radiance: those of its wavelengths, a negative value, or 0 everywhere.

    Parameters
    ----------
    spectrum
        The table.
    where
        File and key for the faults.

    Returns
    -------
    list[InputError]
        The faults; empty for a good table.
    """
    faults = table_faults(spectrum, where)
    if spectrum.values.min() < 0:
        at = spectrum.wavelength_nm[np.argmin(spectrum.values)]
        faults.append(InputError(where, f"radiance {spectrum.values.min():g} at {at:g} nm", "values of 0 or more"))
    elif spectrum.values.max() == 0:
        faults.append(InputError(where, "a radiance of 0 everywhere", "a value above 0"))
    return faults
