"""Lamp nonuniform: the lamp's radiance falls from its centre to its edge.

L(X, Z) is proportional to e + (1 - e)(1 - X^2)(1 - Z^2), X and Z from -1 to 1 across the lamp, mean kept. The cause is
bulbs behind the middle of a diffuser.

Parameters: edge_ratio e, radiance at a corner over that at the centre, null value 1.
Source: lowest even polynomial that is constant along the edges; no publication.
"""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.scene import Scene

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(scene: Scene, edge_ratio: float) -> Scene:
    """Scene with the ratio of each lamp multiplied, so that a ratio of 1 changes nothing."""
    return scene.with_lamps(lambda lamp: replace(lamp, edge_ratio=lamp.edge_ratio * edge_ratio))


EFFECT = Effect(
    id="lamp-nonuniform",
    stage="scene",
    title="the lamp's radiance falls towards its edge",
    in_words="the lamp's corner has {edge_ratio:.1%} of the radiance of its centre",
    summary="The lamp's radiance falls towards its edge as e + (1 - e)(1 - X^2)(1 - Z^2), X and Z from -1 to 1 "
    "across the lamp. Its mean is kept.",
    parameters=(Parameter("edge_ratio", "1", null=1.0, low=0.0, high=1.0, step=0.05),),
    apply=_apply,
    confirm="Photograph the lamp itself at an exposure that does not saturate, or scan it with a spot "
    "radiometer. Otherwise only the shape of penumbrae and the ceiling around the lamp show it.",
)
