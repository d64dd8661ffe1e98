"""Sobol' points with the direction numbers of Joe and Kuo (SIAM J. Sci. Comput. 30, 2008).

They are those of `scipy.stats.qmc`, whose import takes longer than many a command.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["sobol_points"]

#: Bits of a coordinate.
_BITS = 32
#: Of each coordinate after the first, the primitive polynomial over {0, 1} as a number in binary, and the first
#: direction numbers.
_COORDINATES = (
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
    (137, (1, 3, 7, 13, 13, 15, 69)),
)


def sobol_points(dimensions: int, log2_points: int) -> NDArray[np.uint32]:
    """The first points of the sequence, in the order of the Gray code (Antonov and Saleev 1979).

    Parameters
    ----------
    dimensions
        Number of coordinates, 1 to 21.
    log2_points
        Logarithm of the number of points to base 2, 0 to 32.

    Returns
    -------
    NDArray
        (2^m, d) coordinates in units of 2^-32.
    """
    index = np.arange(2**log2_points, dtype=np.uint64)
    gray = index ^ (index >> np.uint64(1))
    points = np.zeros((index.size, dimensions), np.uint32)
    for column in range(dimensions):
        numbers = _direction_numbers(column)
        for bit in range(log2_points):
            flipped = (gray >> np.uint64(bit) & np.uint64(1)).astype(np.uint32)
            points[:, column] ^= flipped * np.uint32(numbers[bit])
    return points


def _direction_numbers(column: int) -> list[int]:
    """Direction numbers of a coordinate, the leading bit first, by the recurrence of its polynomial."""
    if not column:
        return [1 << (_BITS - 1 - bit) for bit in range(_BITS)]
    polynomial, first = _COORDINATES[column - 1]
    degree = polynomial.bit_length() - 1
    numbers = [value << (_BITS - 1 - bit) for bit, value in enumerate(first)]
    for bit in range(degree, _BITS):
        value = numbers[bit - degree] ^ numbers[bit - degree] >> degree
        for term in range(1, degree):
            if polynomial >> (degree - term) & 1:
                value ^= numbers[bit - term]
        numbers.append(value)
    return numbers
