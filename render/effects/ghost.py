"""Ghost: a faint copy of the image, turned by 180 degrees about its centre.

L'(y, x) = (1 - f) L(y, x) + f L(-y, -x), positions relative to the image's centre, the lamp included. The cause is
light that two lens surfaces reflect back onto the sensor.

Parameters: fraction f, without unit, null value 0.
Source: point-symmetric model of one pair of surfaces; no publication.
"""

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
    in_words="the turned copy has {fraction:.2%} of the light",
    summary="Lens surfaces reflect a faint copy of the image: (1 - f) L + f times L turned by 180 degrees about the "
    "image's centre, the lamp included.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=1e-3),),
    apply=_apply,
    confirm="Shade the lamp from the lens: a faint lamp opposite to it disappears. Turning the camera "
    "moves the ghost the other way.",
)
