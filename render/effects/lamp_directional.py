"""Lamp directional: the lamp's radiance falls with the angle from its normal.

L(t) = L0 cos(t)^n, t the angle from the normal; the radiance L0 along the normal stays. The cause is a diffuser that
still lets light pass straight, or a lamp deep in its housing.

Parameters: exponent n, without unit, null value 0 (Lambert's law).
Source: cosine power, the usual one-parameter description of a luminaire; no publication.
"""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.scene import Scene

from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Exponent that is no finding: the frame of a lamp of the published size, 0.2 mm deep, shades oblique rays as much.
_FRAME_TOLERANCE = 0.006


def _apply(scene: Scene, exponent: float) -> Scene:
    """Scene with the exponent added to that of each lamp."""
    return scene.with_lamps(lambda lamp: replace(lamp, exponent=lamp.exponent + exponent))


EFFECT = Effect(
    id="lamp-directional",
    stage="scene",
    title="the lamp's radiance falls with the angle",
    summary="The lamp's radiance falls with the angle t from its normal as L0 cos(t)^n; L0 along the normal is kept.",
    parameters=(Parameter("exponent", "1", null=0.0, low=0.0, high=10.0, step=0.02, tolerance=_FRAME_TOLERANCE),),
    apply=_apply,
    confirm="Measure the lamp's radiance at 0, 45 and 70 degrees from its normal with a spot radiometer. In "
    "the photograph the tops of the walls darken relative to the floor.",
)
