"""Polynomial approximations of functions, which are cheaper in the sampling loops than the general functions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from .libraries import dr, mi

__all__ = ["polynomial", "polynomial_at"]


def polynomial(function: Callable[[np.ndarray], np.ndarray], degree: int) -> tuple[float, ...]:
    """Coefficients, lowest power first, of the interpolation of ``function`` at the Chebyshev points of [0, 1]."""
    fitted = Chebyshev.interpolate(function, degree, [0, 1]).convert(kind=Polynomial)
    return tuple(float(c) for c in fitted.coef)


def polynomial_at(coefficients: tuple[float, ...], x: mi.Float) -> mi.Float:
    """The polynomial at x, by Horner's scheme."""
    value = mi.Float(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = dr.fma(value, x, coefficient)
    return value
