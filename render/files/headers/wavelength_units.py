"""Units of wavelength as files spell them, and wavelengths in nm.

ENVI's documentation lists Micrometers, Nanometers, Millimeters, Centimeters, Meters, Wavenumber, Angstroms, GHz, MHz,
Index and Unknown. Programs also write British spellings, singulars, the symbols, and the micro sign of Unicode.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

__all__ = ["LONGEST_NM", "SHORTEST_NM", "in_nanometres", "nanometres_per_unit", "same_unit", "states_no_unit"]

#: Shortest wavelength of light, nm: vacuum ultraviolet. 0.4 um stated as nm are below it.
SHORTEST_NM = 100.0

#: Longest wavelength of light, nm: far infrared. 400 nm stated as um are above it.
LONGEST_NM = 100_000.0

#: Nanometres per unit, by prefix of the metre.
_NM_PER_PREFIX = {"nano": 1.0, "n": 1.0, "micro": 1e3, "u": 1e3, "milli": 1e6, "centi": 1e7, "": 1e9}

#: Symbols and words that are no metre with a prefix.
_NM_PER_WORD = {"micron": 1e3, "mm": 1e6, "cm": 1e7, "angstrom": 0.1, "å": 0.1, "ångström": 0.1, "ångstrom": 0.1}

#: Spellings of the wavenumber, cm^-1.
_WAVENUMBERS = frozenset({"wavenumber", "wavenumbers", "cm-1", "cm^-1", "1/cm", "cm⁻¹"})

#: Entries that state no unit.
_NO_UNIT = frozenset({"", "unknown", "index", "none", "n/a", "na", "undefined", "unspecified"})

_METRE = re.compile(r"(nano|micro|milli|centi|)met(?:er|re)s?|([nu]|)m")

#: Both micro signs of Unicode as u; the byte in front of one whose UTF-8 was read as Latin-1 as nothing.
_MICRO = str.maketrans({"µ": "u", "μ": "u", "â": None, "Â": None, "î": None, "Î": None, "¼": None})


def _normal(text: object) -> str:
    """Lower case, without quotes, brackets, and spaces, hyphens or underscores inside a word."""
    plain = str(text).strip().strip("\"'()[]{}").strip().lower()
    if plain in _WAVENUMBERS:
        return plain
    return re.sub(r"[\s_.-]+", "", plain.translate(_MICRO))


def states_no_unit(text: object) -> bool:
    """Whether an entry such as ``Unknown`` or ``Index``, or None, states no unit.

    Parameters
    ----------
    text
        The entry.

    Returns
    -------
    bool
        True where a unit has to be declared.
    """
    return text is None or _normal(text) in _NO_UNIT


def nanometres_per_unit(text: object) -> float | None:
    """Nanometres per unit of length.

    Parameters
    ----------
    text
        The unit in any usual spelling, such as ``Nanometers``, ``micrometre`` or ``µm``.

    Returns
    -------
    float or None
        None for what is no unit of length, the wavenumber included.
    """
    unit = _normal(text)
    if match := _METRE.fullmatch(unit):
        return _NM_PER_PREFIX[match[1] or match[2] or ""]
    return _NM_PER_WORD.get(unit, _NM_PER_WORD.get(unit.removesuffix("s")))


def same_unit(first: object, second: object) -> bool:
    """Whether two spellings mean the same unit of wavelength.

    Parameters
    ----------
    first, second
        Units in any usual spelling.

    Returns
    -------
    bool
        False also where one of the two is no unit of wavelength.
    """
    if _normal(first) in _WAVENUMBERS and _normal(second) in _WAVENUMBERS:
        return True
    size = nanometres_per_unit(first)
    return size is not None and size == nanometres_per_unit(second)


def in_nanometres(values: NDArray[np.float64], unit: object) -> NDArray[np.float64] | None:
    """Wavelengths in nm of values in a unit of length, or of wavenumbers in cm^-1.

    Parameters
    ----------
    values
        (w,) wavelengths in ``unit``.
    unit
        The unit in any usual spelling.

    Returns
    -------
    NDArray or None
        (w,) nm in the order of ``values``; None for what is no unit of wavelength.
    """
    if _normal(unit) in _WAVENUMBERS:
        with np.errstate(divide="ignore"):
            return 1e7 / values
    size = nanometres_per_unit(unit)
    return None if size is None else values * size
