"""Pixels of a picture that are not numbers: NaN, infinities, masked pixels and lost tiles.

The nearest pixel that is a number stands in their place, so that filters over neighbours need no mask. No sum and no
test counts them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["NotNumbers", "nearest_numbers", "not_numbers", "of_any"]

#: Planes that a sentence lists; of more it gives the first and the last one.
_MOST_PLANES = 3
#: Pixels that a sentence lists by row and column.
_MOST_PLACES = 3


@dataclass(frozen=True, eq=False)
class NotNumbers:
    """Pixels of one picture that are not numbers in some plane, or are lost."""

    #: (y, x) the pixels.
    pixels: NDArray[np.bool_]
    #: Kinds of values, as "NaN and infinity".
    values: str
    #: Planes that hold them, as "R and G".
    planes: str
    #: Whether the file says that NaN marks pixels that were not measured.
    masked: bool = False
    #: What the pixels are, as "not numbers".
    state: str = "not numbers"

    def sentence(self, side: str) -> str:
        """Number of the pixels, and where they are, in words.

        Parameters
        ----------
        side
            Name of the side.

        Returns
        -------
        str
            The words; rows and columns count from 0.
        """
        rows, columns = np.nonzero(self.pixels)
        pixels = zip(rows[:_MOST_PLACES], columns[:_MOST_PLACES], strict=True)
        first = "; ".join(f"row {row}, column {column}" for row, column in pixels)
        subject = "1 pixel is not a number" if rows.size == 1 else f"{rows.size} pixels are {self.state}"
        text = f"{subject} in the {side} ({self.values} in {self.planes}), at {first}"
        if rows.size > _MOST_PLACES:
            text += f" and others, in {_span('row', rows)}, {_span('column', columns)}"
        return text

    def at(self, rows: slice, columns: slice) -> NotNumbers | None:
        """The same in a part of the picture.

        Parameters
        ----------
        rows, columns
            The part.

        Returns
        -------
        NotNumbers or None
            None where all pixels of the part are numbers.
        """
        pixels = self.pixels[rows, columns]
        return replace(self, pixels=pixels) if pixels.any() else None

    def without(self, pixels: NDArray[np.bool_]) -> NotNumbers | None:
        """The same but some pixels.

        Parameters
        ----------
        pixels
            (y, x) pixels that count no more.

        Returns
        -------
        NotNumbers or None
            None where nothing is left.
        """
        rest = self.pixels & ~pixels
        return replace(self, pixels=rest) if rest.any() else None

    def record(self) -> dict[str, Any]:
        """Content of the JSON file.

        Returns
        -------
        dict
            Numbers and texts; ``bounds_px`` holds the first column and row, and one after the last ones.
        """
        rows, columns = np.nonzero(self.pixels)
        return {
            "pixels": int(rows.size),
            "values": self.values,
            "planes": self.planes,
            "first_row_column": [int(rows[0]), int(columns[0])],
            "bounds_px": [int(n) for n in (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)],
        }


def not_numbers(
    values: NDArray[np.float64], planes: Sequence[str], source: str, *, masked: bool = False
) -> NotNumbers | None:
    """Pixels of a picture that are not numbers.

    Parameters
    ----------
    values
        (y, x, plane) picture.
    planes
        Name of each plane.
    source
        Name of the picture, for the message.
    masked
        Whether NaN marks pixels that were not measured.

    Returns
    -------
    NotNumbers or None
        None for a finite picture.

    Raises
    ------
    InputError
        If no pixel is a number in all planes.
    """
    if values.size == 0 or np.isfinite([values.min(), values.max()]).all():
        return None
    bad = ~np.isfinite(values)
    pixels = np.asarray(bad.any(axis=-1))
    if pixels.all():
        raise InputError(f"{source}: radiance", "no pixel with finite values", "a picture, some pixels of it finite")
    names = [str(name) for name, plane in zip(planes, np.asarray(bad.any(axis=(0, 1))), strict=True) if plane]
    if len(names) > _MOST_PLANES:
        names = [f"{len(names)} planes from {names[0]} to {names[-1]}"]
    kinds = {"NaN": np.isnan(values).any(), "infinity": np.isinf(values).any()}
    return NotNumbers(pixels, _joined([kind for kind, any_ in kinds.items() if any_]), _joined(names), masked)


def of_any(several: Sequence[NotNumbers | None]) -> NotNumbers | None:
    """Pixels that are not numbers in one picture or another.

    Parameters
    ----------
    several
        Those of each picture.

    Returns
    -------
    NotNumbers or None
        None without any.
    """
    each = [absent for absent in several if absent is not None]
    if not each:
        return None
    values, planes = (_joined(list(dict.fromkeys(getattr(a, key) for a in each))) for key in ("values", "planes"))
    masked, state = all(absent.masked for absent in each), " or ".join(dict.fromkeys(absent.state for absent in each))
    return NotNumbers(np.logical_or.reduce([absent.pixels for absent in each]), values, planes, masked, state)


def nearest_numbers(missing: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the nearest pixels that are numbers, as an index of arrays.

    Parameters
    ----------
    missing
        (y, x) pixels that are not numbers, not all of them.

    Returns
    -------
    tuple of NDArray
        (y, x) rows, and columns; each pixel that is a number has its own.
    """
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return rows, columns


def _span(name: str, numbers: NDArray[np.int64]) -> str:
    """First and last of rows or columns in words."""
    first, last = int(numbers.min()), int(numbers.max())
    return f"{name} {first}" if first == last else f"{name}s {first} to {last}"


def _joined(names: Sequence[str]) -> str:
    """Names as a list in words."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
