"""Defocus: blur, alike in all bands.

L' = L convolved with a Gaussian of standard deviation sigma. Beyond the border the outermost pixels are repeated. The
light is blurred before pixels integrate it, if the scene behind the rendering is known, and the pixels otherwise. The
cause is a lens that is not focused on the box.

Parameters: sigma_px, px, null value 0; it grows with the aperture's diameter.
Source: ISO 12233, edge-based spatial frequency response.
"""

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
    in_words="a point is a spot of {sigma_px:.2f} px (standard deviation)",
    summary="The lens blurs by a Gaussian of standard deviation sigma, alike in all bands. Beyond the border the "
    "outermost pixels are repeated. The light is blurred before the pixels receive it, or the pixels themselves if "
    "the scene behind a picture is not known.",
    parameters=(Parameter("sigma_px", "px", null=0.0, low=0.0, high=5.0, step=0.15, grows_with_aperture=True),),
    apply=_apply,
    confirm="Photograph a slanted edge at the box's distance and measure the edge spread, or refocus and "
    "take one band again.",
    sources=("ISO 12233, edge-based spatial frequency response",),
)
