"""Functions as polynomials: what the sampling loops would otherwise call dearer general functions for."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from . import variant as _variant  # noqa: F401  (activates a variant)

__all__ = ["polynomial", "polynomial_at"]


def polynomial(function: Callable[[np.ndarray], np.ndarray], degree: int) -> tuple[float, ...]:
    """Coefficients, lowest power first, of the polynomial that meets ``function`` at Chebyshev's points of [0, 1]."""
    fitted = Chebyshev.interpolate(function, degree, [0, 1]).convert(kind=Polynomial)
    return tuple(float(c) for c in fitted.coef)


def polynomial_at(coefficients: tuple[float, ...], x: mi.Float) -> mi.Float:
    """The polynomial's value, by Horner's scheme."""
    value = mi.Float(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = dr.fma(value, x, coefficient)
    return value
