"""Polynomial approximations, which are cheaper in sampling loops than general functions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from .libraries import dr, mi

__all__ = ["polynomial", "polynomial_at"]


def polynomial(function: Callable[[np.ndarray], np.ndarray], degree: int) -> tuple[float, ...]:
    """Polynomial that interpolates a function at the Chebyshev points of [0, 1].

    Parameters
    ----------
    function
        Function of an array.
    degree
        Degree of the polynomial.

    Returns
    -------
    tuple[float, ...]
        Coefficients, lowest power first.
    """
    fitted = Chebyshev.interpolate(function, degree, [0, 1]).convert(kind=Polynomial)
    return tuple(float(c) for c in fitted.coef)


def polynomial_at(coefficients: tuple[float, ...], x: mi.Float) -> mi.Float:
    """Value of a polynomial, by Horner's scheme.

    Parameters
    ----------
    coefficients
        Coefficients, lowest power first.
    x
        Argument of each lane.

    Returns
    -------
    Float
        Value of each lane.
    """
    value = mi.Float(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = dr.fma(value, x, coefficient)
    return value
