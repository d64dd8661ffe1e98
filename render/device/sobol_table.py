"""Sobol' points without scrambling.

They are those of `scipy.stats`, whose import takes half a second.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_DIMENSIONS", "sobol_table"]

#: Bits of a coordinate.
_BITS = 32

#: Of each dimension after the first, a primitive polynomial over GF(2), its bits from the highest power on, and the
#: first direction numbers. Joe and Kuo, SIAM J. Sci. Comput. 30, 2008, file new-joe-kuo-6.21201.
_DIRECTIONS: tuple[tuple[int, tuple[int, ...]], ...] = (
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

#: Largest number of coordinates of a point.
MOST_DIMENSIONS = 1 + len(_DIRECTIONS)


@lru_cache(maxsize=8)
def sobol_table(dimensions: int, log2_points: int) -> NDArray[np.uint32]:
    """First points of the sequence, in the order of the Gray code.

    Parameters
    ----------
    dimensions
        Number of coordinates d, at most ``MOST_DIMENSIONS``.
    log2_points
        Logarithm m of the number of points.

    Returns
    -------
    NDArray
        (2^m, d) coordinates times 2^32.
    """
    numbers = np.arange(2**log2_points, dtype=np.uint32)
    gray = numbers ^ (numbers >> 1)
    vectors = np.array([_direction_vectors(dimension) for dimension in range(dimensions)], np.uint32)
    points: NDArray[np.uint32] = np.zeros((len(numbers), dimensions), np.uint32)
    for bit in range(log2_points):
        points ^= (gray >> bit & 1)[:, None] * vectors[:, bit]
    return points


def _direction_vectors(dimension: int) -> list[int]:
    """(32,) direction numbers of a dimension, shifted to the highest bits.

    After Bratley and Fox, ACM TOMS 14, 1988.
    """
    if dimension == 0:
        return [1 << _BITS - 1 - bit for bit in range(_BITS)]
    polynomial, first = _DIRECTIONS[dimension - 1]
    degree = len(first)
    vectors = [number << _BITS - 1 - bit for bit, number in enumerate(first)]
    for bit in range(degree, _BITS):
        vector = vectors[bit - degree] ^ vectors[bit - degree] >> degree
        for k in range(1, degree):
            if polynomial >> degree - k & 1:
                vector ^= vectors[bit - k]
        vectors.append(vector)
    return vectors
