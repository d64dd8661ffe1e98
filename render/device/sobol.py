"""Sobol' points as integers, by the direction numbers of Joe and Kuo.

They are those of `scipy.stats.qmc.Sobol` without scrambling, whose import takes longer than many a picture.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["sobol_integers"]

#: Bits of a coordinate.
_BITS = 32

#: Of each dimension from the second on, the coefficients of its primitive polynomial as bits, and its first numbers
#: (Joe and Kuo, SIAM J. Sci. Comput. 30(5), 2008).
_DIRECTIONS = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
    (61, (1, 3, 5, 5, 31)),
    (67, (1, 3, 3, 9, 7, 49)),
    (91, (1, 1, 1, 15, 21, 21)),
    (97, (1, 3, 1, 13, 27, 49)),
)


@lru_cache(maxsize=8)
def sobol_integers(dimensions: int, log2_points: int) -> NDArray[np.uint32]:
    """First points of a Sobol' sequence in the order of the Gray code.

    Parameters
    ----------
    dimensions
        Number of coordinates, 1 to 16.
    log2_points
        Logarithm to base 2 of the number of points, 0 to 32.

    Returns
    -------
    NDArray
        (2^m, d) coordinates times 2^32; not to be written to, since later calls share it.
    """
    index = np.arange(2**log2_points, dtype=np.uint64)
    gray = index ^ (index >> np.uint64(1))
    steps = np.array([_steps(dimension) for dimension in range(dimensions)], np.uint32)
    points = np.zeros((len(index), dimensions), np.uint32)
    for bit in range(log2_points):
        points[(gray >> np.uint64(bit)) & np.uint64(1) == 1] ^= steps[:, bit]
    points.flags.writeable = False
    return points


def _steps(dimension: int) -> list[int]:
    """Direction numbers times 2^32 of one dimension, one of each bit of the point's index."""
    if dimension == 0:
        return [1 << (_BITS - 1 - bit) for bit in range(_BITS)]
    polynomial, first = _DIRECTIONS[dimension - 1]
    degree = len(first)
    steps = [number << (_BITS - 1 - bit) for bit, number in enumerate(first)]
    for bit in range(degree, _BITS):
        step = steps[bit - degree] ^ (steps[bit - degree] >> degree)
        for k in range(1, degree):
            if polynomial >> (degree - k) & 1:
                step ^= steps[bit - k]
        steps.append(step)
    return steps
