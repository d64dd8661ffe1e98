"""Defocus: blur, alike in all bands."""

from __future__ import annotations

import numpy as np

from ._blur import blur
from ._effect import Effect, Light, Parameter

__all__ = ["EFFECT"]


def _apply(light: Light, sigma_px: float) -> Light:
    return light.with_signal(np.stack([blur(image, sigma_px) for image in light.signal]))


EFFECT = Effect(
    id="defocus",
    stage="optics",
    summary="Blur by a Gaussian of standard deviation sigma, alike in all bands. Beyond the border the "
    "outermost pixels are repeated. Small blurs act by sigma squared.",
    parameters=(Parameter("sigma_px", "px", null=0.0, low=0.0, high=5.0, step=0.3),),
    apply=_apply,
    confirm="Photograph a slanted edge at the box's distance and measure the edge spread, or refocus and "
    "take one band again.",
    sources=("ISO 12233, edge-based spatial frequency response",),
)
