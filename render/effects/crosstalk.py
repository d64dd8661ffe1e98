"""Crosstalk: each pixel gives a part of its charge to its four neighbours.

S'(y, x) = (1 - f) S(y, x) + f / 4 times the sum of S over the four neighbours, in scene, flats and reference, before
counts are cut off at full scale. The cause is charge that diffuses sideways before a pixel collects it.

Parameters: fraction f, without unit, null value 0.
Source: Janesick 2001, Scientific Charge-Coupled Devices: charge diffusion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _shared(frame: NDArray[np.float64], fraction: float) -> NDArray[np.float64]:
    """Frame in which pixels share charge; charge at the border returns to the border's pixels.

    So no charge is lost. The dark level is the same in all pixels and stays as it is.
    """
    q = fraction / 4
    weights = np.array([[0, q, 0], [q, 1 - fraction, q], [0, q, 0]])
    return correlate(frame, weights[None], mode="nearest")


def _apply(counts: Counts, fraction: float) -> Counts:
    return replace(
        counts,
        scene=_shared(counts.scene, fraction),
        flat=_shared(counts.flat, fraction),
        reference=_shared(counts.reference, fraction),
    )


EFFECT = Effect(
    id="crosstalk",
    stage="counts",
    title="pixels share charge with their neighbours",
    in_words="a pixel gives {fraction:.2%} of its charge to its neighbours",
    summary="Each pixel gives a fraction of its charge to its four neighbours, a quarter each, before counts "
    "are cut off. Flats and reference are affected too. No charge leaves by the border.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=2e-3),),
    apply=_apply,
    confirm="Light single pixels through a pinhole, or look at hot pixels of long darks: their neighbours "
    "are brighter. In a flat the noise of neighbours is correlated; blur in the lens causes no such correlation.",
    sources=("Janesick 2001, Scientific Charge-Coupled Devices: charge diffusion",),
)
