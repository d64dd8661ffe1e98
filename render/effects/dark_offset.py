"""Dark offset: counts carry an offset that the dark frames lack."""

from __future__ import annotations

from dataclasses import replace

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(counts: Counts, dn: float) -> Counts:
    return replace(counts, scene=counts.scene + dn, flat=counts.flat + dn, reference=counts.reference + dn)


EFFECT = Effect(
    id="dark-offset",
    stage="counts",
    title="counts carry an offset that the darks lack",
    summary="An offset in all frames but the darks: a warmer sensor, a drifting bias, a light leak in the camera.",
    parameters=(Parameter("dn", "DN", null=0.0, low=-200.0, high=200.0, step=1.0),),
    apply=_apply,
    acts_on_charge=False,
    confirm="Take dark frames between the scene's frames, with the lamp on and the lens covered; or a second "
    "exposure of one band: the offset stays, glare grows.",
)
