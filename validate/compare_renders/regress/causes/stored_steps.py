"""Values stored in coarse steps and cut off: half floats, few levels.

Steps are those of each file; the mean of several files has finer ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Part of the values that lie on steps, from which a picture was stored in them.
_ON_STEPS = 0.999
#: Most levels: those of eight bits.
_MOST_LEVELS = 256
#: Fewest pixels for each level.
_PIXELS_PER_LEVEL = 4


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Only where the candidate's values lie on steps, and the baseline's do not."""
    before, after = pictures.files
    if _half(after) > _ON_STEPS > _half(before):
        step = np.spacing(pictures.baseline.astype(np.float16)).astype(float)
        yield Trial(fixed_values({"steps": "half float", "cut off": True}), fixed=-step / 2, selected=1)
        yield Trial(fixed_values({"steps": "half float"}), fixed=0 * step, selected=1)
    levels = np.unique(after)
    enough = after.size >= _PIXELS_PER_LEVEL * levels.size
    if 2 < levels.size <= _MOST_LEVELS and enough and np.unique(before).size > 2 * levels.size:
        above = np.clip(np.searchsorted(levels, before, side="right"), 1, levels.size - 1)
        cut = levels[above - 1]
        near = np.where(before - cut > levels[above] - before, levels[above], cut)
        name = {"steps": "levels", "levels": int(levels.size)}
        yield Trial(fixed_values(name), fixed=(near - before).mean(axis=0), selected=1)
        yield Trial(fixed_values({**name, "cut off": True}), fixed=(cut - before).mean(axis=0), selected=1)


def _half(pictures: NDArray[np.float64]) -> float:
    """Part of the values that half floats hold exactly."""
    with np.errstate(over="ignore"):
        return float((pictures.astype(np.float16).astype(float) == pictures).mean())


CAUSE = Cause("stored-steps", "Values were stored in half floats or few levels.", _trials)
