"""Equally spaced wavelengths: the grid of integrals, and the wider grid of filter curves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["FILTER_GRID", "INTEGRAL_GRID", "WAVELENGTH_NM", "WavelengthGrid", "trapezoidal_weights"]

#: Difference of equal wavelengths, as a fraction of a step: rounding of files.
_SAME = 1e-6


def trapezoidal_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights of the trapezoidal rule: the sum of weights times samples is the integral.

    Parameters
    ----------
    wavelength_nm
        (n,) wavelengths, nm, ascending, with any steps.

    Returns
    -------
    NDArray
        (n,) weights, nm. They integrate the linear interpolation of the samples exactly.
    """
    steps = np.diff(wavelength_nm)
    weights = np.zeros_like(wavelength_nm)
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    return weights


@dataclass(frozen=True)
class WavelengthGrid:
    """Equally spaced wavelengths.

    Raises
    ------
    ValueError
        If the step is not above 0, or there are fewer than two wavelengths.
    """

    #: First wavelength, nm.
    start_nm: float
    #: Step, nm.
    step_nm: float
    #: Number of wavelengths.
    count: int

    def __post_init__(self) -> None:
        if not self.step_nm > 0 or self.count < 2:
            raise ValueError(f"{self.count} wavelengths in steps of {self.step_nm:g} nm are not a grid")

    @cached_property
    def nm(self) -> NDArray[np.float64]:
        """(count,) wavelengths, nm, ascending, read-only."""
        wavelengths = np.array(self.start_nm + self.step_nm * np.arange(self.count), np.float64)
        wavelengths.flags.writeable = False
        return wavelengths

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """(count,) weights of the trapezoidal rule, nm, read-only."""
        weights = trapezoidal_weights(self.nm)
        weights.flags.writeable = False
        return weights

    def __contains__(self, wavelength_nm: float) -> bool:
        """Whether a wavelength in nm is in the grid."""
        index = (wavelength_nm - self.start_nm) / self.step_nm
        return abs(index - round(index)) < _SAME and 0 <= round(index) < self.count

    def matches(self, wavelength_nm: ArrayLike) -> bool:
        """Whether wavelengths are exactly those of this grid.

        Parameters
        ----------
        wavelength_nm
            (n,) wavelengths, nm.

        Returns
        -------
        bool
            True for the same wavelengths in the same order, up to rounding.
        """
        wavelength = np.asarray(wavelength_nm, float)
        return wavelength.shape == (self.count,) and bool(np.all(np.abs(wavelength - self.nm) < _SAME * self.step_nm))

    def part(self, inner: WavelengthGrid) -> slice:
        """Indices of the wavelengths of another grid in this one.

        Parameters
        ----------
        inner
            A grid within this one; its step is a multiple of this grid's.

        Returns
        -------
        slice
            Indices such that ``nm[part(inner)]`` are the wavelengths of ``inner``.

        Raises
        ------
        ValueError
            If this grid lacks a wavelength of the other.
        """
        first, last = inner.start_nm, inner.start_nm + inner.step_nm * (inner.count - 1)
        if first not in self or last not in self or first + inner.step_nm not in self:
            raise ValueError(f"{inner} is not part of {self}")
        start, stride = (first - self.start_nm) / self.step_nm, inner.step_nm / self.step_nm
        return slice(round(start), round(start) + round(stride) * (inner.count - 1) + 1, round(stride))

    def between(self, low_nm: float, high_nm: float) -> WavelengthGrid:
        """Grid of the wavelengths from one to another, both included.

        Parameters
        ----------
        low_nm, high_nm
            First and last wavelength, nm.

        Returns
        -------
        WavelengthGrid
            The grid, with the same step.

        Raises
        ------
        ValueError
            If these two are not in this grid.
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
