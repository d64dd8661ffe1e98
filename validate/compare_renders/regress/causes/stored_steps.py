"""Values stored in coarse steps and cut off: half floats, eight bits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Part of the values that lie on steps, from which a picture was stored in them.
_ON_STEPS = 0.999
#: Most levels of a picture of eight bits.
_EIGHT_BITS = 256
#: Fewest pixels for each level.
_PIXELS_PER_LEVEL = 4


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Only where the candidate's values lie on steps, and the baseline's do not."""
    if _half(pictures.candidate) > _ON_STEPS > _half(pictures.baseline):
        step = np.spacing(pictures.baseline.astype(np.float16)).astype(float)
        yield Trial(fixed_values({"steps": "half float", "cut off": True}), fixed=-step / 2, selected=1)
        yield Trial(fixed_values({"steps": "half float"}), fixed=0 * step, selected=1)
    levels = np.unique(pictures.candidate)
    enough = pictures.candidate.size >= _PIXELS_PER_LEVEL * levels.size
    if 2 < levels.size <= _EIGHT_BITS and enough and np.unique(pictures.baseline).size > 2 * levels.size:
        above = np.clip(np.searchsorted(levels, pictures.baseline, side="right"), 1, levels.size - 1)
        cut = levels[above - 1]
        near = np.where(pictures.baseline - cut > levels[above] - pictures.baseline, levels[above], cut)
        yield Trial(fixed_values({"steps": "eight bits"}), fixed=near - pictures.baseline, selected=1)
        yield Trial(fixed_values({"steps": "eight bits", "cut off": True}), fixed=cut - pictures.baseline, selected=1)


def _half(picture: NDArray[np.float64]) -> float:
    """Part of the values that half floats hold exactly."""
    with np.errstate(over="ignore"):
        return float((picture.astype(np.float16).astype(float) == picture).mean())


CAUSE = Cause("stored-steps", "Values were stored in half floats or eight bits.", _trials)
