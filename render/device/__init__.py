"""Support for the numerical kernels: their libraries, the Mitsuba variant, sampling points, polynomials."""

from .libraries import dr, mi
from .polynomials import polynomial, polynomial_at
from .sampling import SobolPoints, cosine_hemisphere

__all__ = ["SobolPoints", "cosine_hemisphere", "dr", "mi", "polynomial", "polynomial_at"]
