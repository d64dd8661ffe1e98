"""Relative spectra of lights by name: CIE illuminants and black bodies."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np
from cboxlab.utils.errors import InputError

from .spectra import Spectrum, planck

__all__ = ["LIGHT_NAMES", "named_light"]

#: CIE illuminants by the name here, with their names in colour-science.
_ILLUMINANTS = {
    "A": "A",
    "D50": "D50",
    "D65": "D65",
    **{f"F{number}": f"FL{number}" for number in range(1, 13)},
}
#: Names for messages.
LIGHT_NAMES = '"A", "D50", "D65", "F1" to "F12", or "planck TEMPERATURE_K"'
#: Wavelength of the value 1, nm: where the CIE sets the tables of A and D65 to 100.
_UNITY_NM = 560.0
#: Temperatures of black bodies, K.
_TEMPERATURES_K = (500.0, 50000.0)
#: Wavelengths of a black body's table, nm.
_PLANCK_NM = np.arange(300.0, 1101.0)

_PLANCK = re.compile(r"planck\s+(\d+(\.\d+)?)(\s*K)?")


@lru_cache(maxsize=16)
def named_light(name: str) -> Spectrum | None:
    """Relative spectrum of a light by its name, 1 at 560 nm and zero beyond its table.

    The tables are those of CIE 15 and CIE 018, by colour-science, in steps of 5 nm.

    Parameters
    ----------
    name
        "A", "D50", "D65", "F1" to "F12", or "planck 2900" with a temperature in K.

    Returns
    -------
    Spectrum | None
        The spectrum; None for another name.

    Raises
    ------
    InputError
        For a temperature outside 500 to 50000 K.
    """
    if match := _PLANCK.fullmatch(name.strip()):
        temperature = float(match[1])
        low, high = _TEMPERATURES_K
        if not low <= temperature <= high:
            raise InputError(f"'{name[:40]}'", f"{temperature:g} K", f"a temperature from {low:g} to {high:g} K")
        values = planck(_PLANCK_NM, temperature)
        return Spectrum(_PLANCK_NM, values / planck(_UNITY_NM, temperature), "zero")
    if name not in _ILLUMINANTS:
        return None
    from colour import SDS_ILLUMINANTS

    table = SDS_ILLUMINANTS[_ILLUMINANTS[name]]
    light = Spectrum(np.array(table.wavelengths), np.array(table.values), "zero")
    return light.scaled(1.0 / float(light.at(_UNITY_NM)))
