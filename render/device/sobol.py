"""Sobol' points as integers, by the direction numbers of Joe and Kuo, SIAM J. Sci. Comput. 30, 2008."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_DIMENSIONS", "sobol_integers"]

#: Primitive polynomial of each dimension as bits, and the first direction numbers (their file new-joe-kuo-6).
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
    (103, (1, 1, 1, 15, 7, 5)),
    (109, (1, 3, 1, 15, 13, 25)),
    (115, (1, 1, 5, 5, 19, 61)),
    (131, (1, 3, 7, 11, 23, 15, 103)),
)
#: Largest number of dimensions; the first one, of van der Corput, has no polynomial.
MOST_DIMENSIONS = len(_DIRECTIONS) + 1
#: Bits of a coordinate.
_BITS = 32


def sobol_integers(dimensions: int, log2_points: int) -> NDArray[np.uint32]:
    """First points of the sequence, in the order of the Gray code.

    They are those of `scipy.stats.qmc.Sobol`, without the import of `scipy.stats`, which takes longer.

    Parameters
    ----------
    dimensions
        Number of coordinates of a point, 1 to MOST_DIMENSIONS.
    log2_points
        Base-2 logarithm of the number of points.

    Returns
    -------
    NDArray
        (2^log2_points, dimensions) coordinates times 2^32.
    """
    directions = np.array([[1 << (_BITS - 1 - bit) for bit in range(_BITS)], *map(_direction_numbers, _DIRECTIONS)])
    number = np.arange(2**log2_points)
    gray = number ^ (number >> 1)
    points = np.zeros((number.size, dimensions), np.uint32)
    for bit in range(log2_points):
        points ^= np.where((gray >> bit & 1)[:, None], directions[:dimensions, bit], 0).astype(np.uint32)
    return points


def _direction_numbers(dimension: tuple[int, tuple[int, ...]]) -> list[int]:
    """(32,) direction numbers times 2^32 of a polynomial and its first numbers."""
    polynomial, first = dimension
    degree = len(first)
    numbers = [value << (_BITS - 1 - bit) for bit, value in enumerate(first)]
    for bit in range(degree, _BITS):
        number = numbers[bit - degree] ^ (numbers[bit - degree] >> degree)
        for term in range(1, degree):
            if polynomial >> (degree - term) & 1:
                number ^= numbers[bit - term]
        numbers.append(number)
    return numbers
