"""Ghost: a faint copy of the image, turned by 180 degrees about its centre."""

from __future__ import annotations

from ..chain import Light
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(light: Light, fraction: float) -> Light:
    return light.with_signal((1 - fraction) * light.signal + fraction * light.signal[:, ::-1, ::-1])


EFFECT = Effect(
    id="ghost",
    stage="optics",
    title="a faint copy of the image, turned by 180 degrees",
    summary="A reflection between lens surfaces: (1 - f) L + f times L turned by 180 degrees about the "
    "image's centre, the lamp included.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=1e-3),),
    apply=_apply,
    confirm="Shade the lamp from the lens's view: a faint lamp opposite to it disappears. Turning the camera "
    "moves the ghost the other way.",
)
