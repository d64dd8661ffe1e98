"""Veiling glare: a part of all light spreads evenly over the image.

L' = (1 - f) L + f times the mean of L over the image, the lamp included. The cause is light that lens and sensor
scatter over wide angles.

Parameters: fraction f, without unit, null value 0.
Source: ISO 9358:1994, veiling glare of image-forming systems.
"""

from __future__ import annotations

from ..chain import Light
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(light: Light, fraction: float) -> Light:
    mean = light.signal.mean(axis=(1, 2), keepdims=True)
    return light.with_signal((1 - fraction) * light.signal + fraction * mean)


EFFECT = Effect(
    id="veiling-glare",
    stage="optics",
    title="a part of all light spreads over the image",
    in_words="{fraction:.2%} of all light spreads evenly over the image",
    summary="Lens and sensor spread a fraction f of all light evenly: L becomes (1 - f) L + f mean(L), lamp included.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=1e-3),),
    apply=_apply,
    confirm="Photograph a black trap (a hole in a dark box) in the middle of the lit scene: its signal above dark is "
    "glare. Shading the lamp from the lens changes glare, but not an offset of the counts.",
    sources=("ISO 9358:1994, veiling glare of image-forming systems",),
)
