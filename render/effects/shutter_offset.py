"""Shutter offset: every exposure is longer than commanded by the same time.

S' = S (1 + d / t), with S the signal above dark and t the commanded exposure. Dark frames already show the level of the
longer exposure. The cause is the time that a shutter takes to open and close.

Parameters: seconds d, s, null value 0.
Source: no formula from a publication.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _longer(
    frame: NDArray[np.float64], dark: NDArray[np.float64], exposure_s: NDArray[np.float64], seconds: float
) -> NDArray[np.float64]:
    """Frame (band, y, x) of exposures longer by ``seconds``; its dark level is kept."""
    level = dark[:, None, None]
    return level + (frame - level) * (1 + seconds / exposure_s)[:, None, None]


def _apply(counts: Counts, seconds: float) -> Counts:
    """Counts of longer exposures; the dark frames already have the level of longer exposures."""
    return replace(
        counts,
        scene=_longer(counts.scene, counts.dark_scene, counts.exposure_scene, seconds),
        flat=_longer(counts.flat, counts.dark_flat, counts.exposure_flat, seconds),
        reference=_longer(counts.reference, counts.dark_reference, counts.exposure_reference, seconds),
    )


EFFECT = Effect(
    id="shutter-offset",
    stage="counts",
    title="every exposure is longer than commanded",
    in_words="every exposure is {seconds:+.4f} s longer",
    summary="Every exposure, including the darks, is longer than commanded by the same time. Signals are multiplied "
    "by 1 + seconds / exposure.",
    parameters=(Parameter("seconds", "s", null=0.0, low=-0.2, high=1.0, step=1e-3),),
    apply=_apply,
    confirm="Take one band at a short and a long exposure: signal over commanded time differs between them. Or "
    "time the shutter with a photodiode.",
)
