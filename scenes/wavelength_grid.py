"""Equally spaced wavelengths: the grid of all integrals over wavelength, and the wider grid of filter curves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["FILTER_GRID", "INTEGRAL_GRID", "WAVELENGTH_NM", "WavelengthGrid", "trapezoidal_weights"]

#: Wavelengths that differ by less than this fraction of a step are equal.
_SAME = 1e-6


def trapezoidal_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) weights in nm: the sum of weights times samples is the integral of their linear interpolation."""
    steps = np.diff(wavelength_nm)
    weights = np.zeros_like(wavelength_nm)
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    return weights


@dataclass(frozen=True)
class WavelengthGrid:
    """``count`` wavelengths from ``start_nm`` in steps of ``step_nm``, both in nm.

    Raises ValueError for a step that is not above 0 or fewer than two wavelengths.
    """

    start_nm: float
    step_nm: float
    count: int

    def __post_init__(self) -> None:
        if not self.step_nm > 0 or self.count < 2:
            raise ValueError(f"{self.count} wavelengths in steps of {self.step_nm:g} nm are not a grid")

    @cached_property
    def nm(self) -> NDArray[np.float64]:
        """(count,) the wavelengths, ascending, read-only."""
        wavelengths = np.array(self.start_nm + self.step_nm * np.arange(self.count), np.float64)
        wavelengths.flags.writeable = False
        return wavelengths

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """(count,) nm, of the trapezoidal rule (see ``trapezoidal_weights``), read-only."""
        weights = trapezoidal_weights(self.nm)
        weights.flags.writeable = False
        return weights

    def __contains__(self, wavelength_nm: float) -> bool:
        """Whether a wavelength in nm is in the grid."""
        place = (wavelength_nm - self.start_nm) / self.step_nm
        return abs(place - round(place)) < _SAME and 0 <= round(place) < self.count

    def matches(self, wavelength_nm: ArrayLike) -> bool:
        """Whether wavelengths (n,) in nm are exactly those of this grid, in order."""
        found = np.asarray(wavelength_nm, float)
        return found.shape == (self.count,) and bool(np.all(np.abs(found - self.nm) < _SAME * self.step_nm))

    def part(self, inner: WavelengthGrid) -> slice:
        """Indices of the wavelengths of another grid in this one: ``nm[part(inner)]`` are those of ``inner``.

        Raises ValueError if this grid lacks one of them.
        """
        first, last = inner.start_nm, inner.start_nm + inner.step_nm * (inner.count - 1)
        if first not in self or last not in self or first + inner.step_nm not in self:
            raise ValueError(f"{inner} is not part of {self}")
        start, stride = (first - self.start_nm) / self.step_nm, inner.step_nm / self.step_nm
        return slice(round(start), round(start) + round(stride) * (inner.count - 1) + 1, round(stride))

    def between(self, low_nm: float, high_nm: float) -> WavelengthGrid:
        """The wavelengths of this grid from ``low_nm`` to ``high_nm``, both included.

        Raises ValueError if these two are not in the grid.
        """
        if low_nm not in self or high_nm not in self:
            raise ValueError(f"{low_nm:g} or {high_nm:g} nm is not a wavelength of {self}")
        return WavelengthGrid(low_nm, self.step_nm, round((high_nm - low_nm) / self.step_nm) + 1)


#: The grid of all integrals over wavelength, 400 to 700 nm; in the capture format the lens transmits only this range.
INTEGRAL_GRID = WavelengthGrid(400.0, 1.0, 301)

#: The grid of filter curves, 380 to 800 nm, wider than INTEGRAL_GRID so that a filter can be shifted in wavelength.
FILTER_GRID = WavelengthGrid(380.0, 1.0, 421)

#: (301,) nm, the wavelengths of INTEGRAL_GRID.
WAVELENGTH_NM = INTEGRAL_GRID.nm
