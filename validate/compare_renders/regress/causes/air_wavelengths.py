"""Wavelengths in air taken for those in vacuum, or the reverse.

The index of standard air is that of Edlen's formula in the simple form of Birch and Downs (1993, Metrologia 30, 155).
"""

from __future__ import annotations

from collections.abc import Iterator

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Fewest wavelengths for a spline.
_MIN_WAVELENGTHS = 4


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Shift of 0.11 to 0.2 nm in the visible range."""
    from scipy.interpolate import CubicSpline  # slow to import

    at = pictures.wavelength_nm
    if at is None or at.size < _MIN_WAVELENGTHS:
        return
    inverse = (1e3 / at) ** 2
    excess = 1e-8 * (8342.54 + 2406147 / (130 - inverse) + 15998 / (38.9 - inverse))
    slope = CubicSpline(at, pictures.baseline, axis=-1).derivative()(at)
    for name, sign in (("in air, taken for vacuum", 1.0), ("in vacuum, taken for air", -1.0)):
        yield Trial(fixed_values({"wavelengths": name}), fixed=slope * (sign * at * excess), selected=1)


CAUSE = Cause("air-wavelengths", "Wavelengths in air and in vacuum were exchanged.", _trials, shape_error=0.06)
