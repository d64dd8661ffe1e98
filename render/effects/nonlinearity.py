"""Nonlinearity: counts are not proportional to light.

DN' = DN (1 + b DN / DN_max), on the whole count, bias included, in all frames. DN_max is the full scale. The cause is
the amplifier or the converter.

Parameters: b, without unit, null value 0.
Source: EMVA 1288, linearity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _bent(dn: NDArray[np.float64], b: float, full_scale: float) -> NDArray[np.float64]:
    """Counts on the curve, continued beyond full scale with the slope at full scale.

    Frames are cut off at full scale afterwards.
    """
    inside = np.minimum(dn, full_scale)
    return inside * (1 + b * inside / full_scale) + (1 + 2 * b) * (dn - inside)


def _apply(counts: Counts, b: float) -> Counts:
    def bent(dn: NDArray[np.float64]) -> NDArray[np.float64]:
        return _bent(dn, b, counts.full_scale)

    return replace(
        counts,
        scene=bent(counts.scene),
        flat=bent(counts.flat),
        reference=bent(counts.reference),
        dark_scene=bent(counts.dark_scene),
        dark_flat=bent(counts.dark_flat),
        dark_reference=bent(counts.dark_reference),
    )


EFFECT = Effect(
    id="nonlinearity",
    stage="counts",
    title="counts bend towards full scale",
    summary="Counts are not proportional to light: DN' = DN (1 + b DN / DN_max), on the whole count, bias included, "
    "in all frames.",
    parameters=(Parameter("b", "1", null=0.0, low=-0.3, high=0.3, step=2e-3),),
    apply=_apply,
    acts_on_charge=False,
    confirm="Take a bracket of exposures of one band; a further exposure at half the time is enough. The counts are "
    "not proportional to the time.",
    sources=("EMVA 1288, linearity",),
)
