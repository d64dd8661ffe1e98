"""Smear: each pixel receives a part of its column's mean signal.

DN' = DN + f times the column's mean signal above dark, before counts are cut off at full scale, in flats and reference
too. The cause is light that arrives while charge is shifted along the columns.

Parameters: fraction f, without unit, null value 0.
Source: Janesick 2001, Scientific Charge-Coupled Devices: frame-transfer smear.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _smeared(frame: NDArray[np.float64], dark: NDArray[np.float64], fraction: float) -> NDArray[np.float64]:
    return frame + fraction * (frame.mean(axis=1, keepdims=True) - dark[:, None, None])


def _apply(counts: Counts, fraction: float) -> Counts:
    return replace(
        counts,
        scene=_smeared(counts.scene, counts.dark_scene, fraction),
        flat=_smeared(counts.flat, counts.dark_flat, fraction),
        reference=_smeared(counts.reference, counts.dark_reference, fraction),
    )


EFFECT = Effect(
    id="smear",
    stage="counts",
    title="columns receive a part of their mean",
    in_words="every column receives {fraction:.3%} of its mean",
    summary="Light arrives while charge is shifted along the columns. It adds the fraction times the column's mean "
    "signal, before counts are cut off. Flats and reference are affected too.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=1e-3),),
    apply=_apply,
    confirm="Take the scene with a shutter that closes before readout. Or double the exposure: smear over signal "
    "halves. The columns through the lamp show it above and below the lamp.",
    sources=("Janesick 2001, Scientific Charge-Coupled Devices: frame-transfer smear",),
)
