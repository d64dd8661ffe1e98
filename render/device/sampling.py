"""Low-discrepancy points and the map from the unit square to directions."""

from __future__ import annotations

import numpy as np

from .arrays import device_array
from .libraries import dr, mi
from .polynomials import polynomial, polynomial_at
from .sobol_table import sobol_table

__all__ = ["SobolPoints", "cosine_hemisphere", "seed_of_lanes"]


def seed_of_lanes(seed: int | mi.UInt32) -> mi.UInt32:
    """Seed as data of a kernel, not as a literal in its code.

    Parameters
    ----------
    seed
        One seed for all lanes, or one for each.

    Returns
    -------
    UInt32
        The seed or seeds, modulo 2^32.
    """
    return seed if isinstance(seed, mi.UInt32) else dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)


class SobolPoints:
    """Owen-scrambled Sobol' points, scrambled independently for every lane and seed.

    Nested uniform scrambling by hashing after Laine and Karras (2011), constants of Burley, "Practical Hash-based Owen
    Scrambling", JCGT 9(4), 2020. Each scrambled point is uniformly distributed, so each lane's mean over all points is
    unbiased. The points of a lane remain stratified, so its error decreases faster than with independent points.

    Parameters
    ----------
    dimensions
        Number of coordinates of a point.
    count
        Number of points of each lane; the table is rounded up to a power of two.
    lane
        Number of each lane, from which its scrambling is derived.
    seed
        Seed of all lanes, or of each.
    """

    def __init__(self, dimensions: int, count: int, lane: mi.UInt32, seed: int | mi.UInt32) -> None:
        log2 = int(np.ceil(np.log2(max(count, 2))))
        self.dimensions = dimensions
        self._table = device_array(mi.UInt32, sobol_table(dimensions, log2).ravel())
        seeds = seed_of_lanes(seed)
        self._seeds = [
            mi.sample_tea_32(lane, seeds + (0x9E3779B9 * (d + 1) & 0xFFFFFFFF))[0] for d in range(dimensions)
        ]

    def point(self, index: mi.UInt32, dimension: int) -> mi.Float:
        """One coordinate of one point.

        Parameters
        ----------
        index
            Index of each lane's point.
        dimension
            Index of the coordinate.

        Returns
        -------
        Float
            Number in [0, 1), of 24 bits.
        """
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


#: sin(pi / 4 t) / t as a polynomial in t^2, for -1 <= t <= 1, with an error below 1e-8.
_SINE = polynomial(lambda s: np.sin(np.pi / 4 * np.sqrt(s)) / np.sqrt(s), 3)
#: cos(pi / 4 t) as a polynomial in t^2, for -1 <= t <= 1, with an error below 1e-8.
_COSINE = polynomial(lambda s: np.cos(np.pi / 4 * np.sqrt(s)), 3)


def cosine_hemisphere(normal: mi.Vector3f, u: mi.Float, v: mi.Float) -> mi.Vector3f:
    """Direction around a normal with density cos(theta) / pi.

    Malley's method: a uniform point of the unit disk is projected up to the hemisphere. The map to the disk is the
    concentric one of Shirley and Chiu (Journal of Graphics Tools 2(3), 1997), which preserves stratification. With the
    polar map the variance of a gather with 2048 Sobol' points is 8% larger.

    Parameters
    ----------
    normal
        Unit normal of each lane.
    u
        First random number, in [0, 1).
    v
        Second random number, in [0, 1).

    Returns
    -------
    Vector3f
        Unit directions.
    """
    a, b = 2 * u - 1, 2 * v - 1
    upright = dr.abs(a) < dr.abs(b)
    radius, across = dr.select(upright, b, a), dr.select(upright, a, b)
    t = across * dr.rcp(dr.select(radius == 0, 1, radius))
    along = radius * polynomial_at(_COSINE, t * t)
    across = radius * t * polynomial_at(_SINE, t * t)
    x, y = dr.select(upright, across, along), dr.select(upright, along, across)
    return mi.Frame3f(normal).to_world(mi.Vector3f(x, y, dr.sqrt(1 - radius * radius)))
