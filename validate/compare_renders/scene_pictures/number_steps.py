"""Steps of the numbers of a picture: of a file's format, or of sums in few digits.

That all values of one side lie on coarse steps, and those of the other do not, is a fact without noise. A half float
has 11 significant bits, a single float 24, so that 64 values of single floats are all half floats with a probability of
8192^-64. Steps of sums have the same relative size, but any factor, such as one over the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["NumberSteps", "steps_of"]

#: Fewest different values of a statement.
_LEAST_VALUES = 64
#: Most levels of a picture of eight bits.
_EIGHT_BITS = 256
#: Fewest values for each level.
_VALUES_PER_LEVEL = 4
#: Bits of the largest channel of a pixel of a shared exponent.
_SHARED_BITS = 8
#: Most significant bits of coarse steps: bfloat16 has 8, half floats and TF32 have 11, integers in files 16.
_MOST_BITS = 13.0
#: Intervals an octave: the step is constant in each, but for one.
_INTERVALS = 8
#: Fewest gaps between values of an interval.
_LEAST_GAPS = 12
#: Part of the values that have to lie in intervals with steps.
_MOST_VALUES = 0.8
#: Largest error of a multiple that can be checked.
_LARGEST_ERROR = 0.25
#: Error of a gap, over the values: single precision of both, and of the step.
_PRECISION = 4 * 2.0**-24
#: Most bits by which the finest interval is finer than another: those of an octave's upper end over its lower end.
_OCTAVE = 1.1


@dataclass(frozen=True)
class NumberSteps:
    """Numbers of a side."""

    #: Numbers in words.
    text: str
    #: Whether they are coarser than 32-bit floats.
    coarse: bool = False


def steps_of(pictures: NDArray[np.float64]) -> NumberSteps:
    """Coarsest numbers that hold all values of a side.

    Parameters
    ----------
    pictures
        (..., w) values of all files of the side.

    Returns
    -------
    NumberSteps
        Levels, a shared exponent, half floats, steps of sums, 32-bit floats or finer numbers.
    """
    values = np.unique(np.abs(pictures[pictures != 0]))
    enough = values.size >= _LEAST_VALUES
    if enough and pictures.shape[-1] == 3 and _have_shared_exponents(pictures):
        return NumberSteps("shared exponents (RGBE)", coarse=True)
    if 2 < values.size <= _EIGHT_BITS and pictures.size >= _VALUES_PER_LEVEL * values.size:
        return NumberSteps(f"at most {_EIGHT_BITS} levels", coarse=True)
    if not enough:
        return NumberSteps("few values")
    with np.errstate(over="ignore"):
        if np.array_equal(values.astype(np.float16).astype(float), values):
            return NumberSteps("half floats", coarse=True)
        single = np.array_equal(values.astype(np.float32).astype(float), values)
    bits, part = _steps_of_sums(values)
    if part >= _MOST_VALUES:
        return NumberSteps(f"numbers of {bits} significant bits times a factor, as sums in few digits are", coarse=True)
    return NumberSteps("32-bit floats" if single else "finer numbers")


def _have_shared_exponents(pictures: NDArray[np.float64]) -> bool:
    """Whether each pixel's values are half steps of 1/128 to 1/256 of the largest."""
    pixels = np.abs(pictures.reshape(-1, 3))
    largest = pixels.max(axis=-1)
    pixels, largest = pixels[largest > 0], largest[largest > 0]
    halves = np.ldexp(pixels, (_SHARED_BITS + 1 - np.frexp(largest)[1])[:, None])
    return bool((halves == np.round(halves)).all())


def _steps_of_sums(values: NDArray[np.float64]) -> tuple[int, float]:
    """Significant bits of values on steps, and the part of the values on them.

    Inside a short interval the gaps of sorted values are then whole multiples of the smallest one.
    """
    interval = np.floor(_INTERVALS * np.log2(values)).astype(int)
    sizes, bits = [], []
    for part in np.split(values, np.flatnonzero(np.diff(interval)) + 1):
        gaps = np.diff(part)
        if gaps.size < _LEAST_GAPS:
            continue
        step = float(gaps.min())
        multiples = gaps / step
        error = _PRECISION * part[-1] / step * (1 + multiples)
        clear = error < _LARGEST_ERROR
        fits = np.abs(multiples - np.round(multiples))[clear] < error[clear]
        sizes.append(part.size)
        bits.append(float(np.log2(part[0] / step)) if fits.size >= _LEAST_GAPS and fits.all() else np.inf)
    number, fineness = np.array(sizes), np.array(bits)
    on_steps = fineness < _MOST_BITS
    if not on_steps.any() or number.sum() < _LEAST_VALUES:
        return 0, 0.0
    finest = float(fineness[on_steps].max())
    alike = on_steps & (fineness > finest - _OCTAVE)
    return int(np.floor(finest)) + 1, float(number[alike].sum() / number.sum())
