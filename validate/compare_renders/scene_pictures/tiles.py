"""Tiles that one picture of a side has lost: one value where its companions have noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from .absent_numbers import NotNumbers

__all__ = ["lost_tiles"]

#: Pixels of the smallest tile: renderers' tiles have 8 px a side or more.
_LEAST_PX = 64
#: Part of the rectangle around a tile that it fills: all but its pixels next to a picture's border.
_SOLID = 0.98
#: Part of a tile's pixels in which companions differ from their neighbours. Sparse light has many equal pixels.
_NOISY = 0.5
#: Pixels that a pixel filter or a median makes equal together, px.
_TOGETHER_PX = 4
#: Chance at which a rectangle of equal pixels is no noise, all places of a picture counted.
_CHANCE = 1e-9


def lost_tiles(stack: NDArray[np.float64], names: Sequence[str]) -> list[NotNumbers | None]:
    """Pixels of each picture in tiles that it has lost.

    A tile is lost where one picture has the same value in all pixels of a rectangle, such as 0, and its companions have
    noise there. Noise of samples has equal neighbours only where light is sparse, and then in the companions, too.

    Parameters
    ----------
    stack
        (n, y, x, plane) pictures of one view with independent noise, two or more.
    names
        Name of each picture.

    Returns
    -------
    list of NotNumbers or None
        Of each picture; None without a lost tile.
    """
    along_row, along_column = (_equal_to_a_neighbour(stack, axis) for axis in (2, 1))
    even = along_row & along_column
    noisy = (~even).sum(axis=0)
    result: list[NotNumbers | None] = []
    for picture, name in zip(even, names, strict=True):
        lost = np.zeros(picture.shape, bool)
        numbers, _ = label(picture)
        bounds_of = find_objects(numbers)
        for number in np.flatnonzero(np.bincount(numbers.ravel())[1:] >= _LEAST_PX) + 1:
            bounds = bounds_of[number - 1]
            tile = numbers[bounds] == number
            companions = float(noisy[bounds][tile].mean()) / (len(stack) - 1)
            # as by the rule of succession, since noise everywhere would leave no chance at all
            equal = (1 - companions) + 1 / (tile.sum() + 1)
            chance = picture.size * min(equal, 1.0) ** (tile.sum() / _TOGETHER_PX)
            if tile.mean() >= _SOLID and companions >= _NOISY and chance < _CHANCE:
                lost[bounds] |= tile
        values = f"one value in {name} alone"
        result.append(NotNumbers(lost, values, "all planes", state="a lost tile") if lost.any() else None)
    return result


def _equal_to_a_neighbour(stack: NDArray[np.float64], axis: int) -> NDArray[np.bool_]:
    """(n, y, x) True where a pixel has the values of the one before or after it along an axis."""
    same = np.asarray((np.diff(stack, axis=axis) == 0).all(axis=-1))
    before, after = ([(0, 0), (0, 0), (0, 0)] for _ in range(2))
    before[axis], after[axis] = (1, 0), (0, 1)
    return np.asarray(np.pad(same, before) | np.pad(same, after))
