"""Defocus: blur, alike in all bands."""

from __future__ import annotations

import numpy as np

from ..chain import Light
from .blur import blurred
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(light: Light, sigma_px: float) -> Light:
    return blurred(light, np.full(len(light.signal), sigma_px))


EFFECT = Effect(
    id="defocus",
    stage="optics",
    title="blur, alike in all bands",
    summary="Blur by a Gaussian of standard deviation sigma, alike in all bands. Beyond the border the "
    "outermost pixels are repeated. The light is blurred before the pixels see it; where the scene behind a "
    "picture is not known, its pixels are.",
    parameters=(Parameter("sigma_px", "px", null=0.0, low=0.0, high=5.0, step=0.15, grows_with_aperture=True),),
    apply=_apply,
    confirm="Photograph a slanted edge at the box's distance and measure the edge spread, or refocus and "
    "take one band again.",
    sources=("ISO 12233, edge-based spatial frequency response",),
)
