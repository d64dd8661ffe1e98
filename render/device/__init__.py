"""Support for the kernels: libraries, Mitsuba variant, sampling points, polynomials."""

from .arrays import device_array
from .calls import finish_call, lane_ranges, lanes_per_call
from .libraries import dr, mi
from .polynomials import polynomial, polynomial_at
from .sampling import SobolPoints, cosine_hemisphere, seed_of_lanes
from .sobol_table import sobol_table

__all__ = [
    "SobolPoints",
    "cosine_hemisphere",
    "device_array",
    "dr",
    "finish_call",
    "lane_ranges",
    "lanes_per_call",
    "mi",
    "polynomial",
    "polynomial_at",
    "seed_of_lanes",
    "sobol_table",
]
