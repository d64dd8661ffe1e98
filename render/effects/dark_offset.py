"""Dark offset: counts carry an offset that the dark frames lack.

DN' = DN + dn in the frames of scene, flats and reference; dark frames stay as they are. Causes are a sensor that warmed
up after the darks, a drifting bias, and light that leaks into the camera.

Parameters: dn, DN, null value 0.
Source: no formula from a publication.
"""

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
    in_words="every count carries {dn:+.2f} DN",
    summary="Counts have an offset in all frames except the darks. "
    "Causes are a warmer sensor, a drifting bias, or a light leak in the camera.",
    parameters=(Parameter("dn", "DN", null=0.0, low=-200.0, high=200.0, step=1.0),),
    apply=_apply,
    acts_on_charge=False,
    confirm="Take dark frames between the scene's frames, with the lamp on and the lens covered. Or take a second, "
    "longer exposure of one band: the offset stays, glare grows.",
)
