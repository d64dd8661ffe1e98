"""Chromatic focus: blur that grows away from one wavelength.

The blur of a band is a Gaussian of standard deviation s |lambda - 550 nm| / 100 nm, lambda the mean wavelength of the
band's signal. The cause is longitudinal chromatic aberration: the focal length changes with wavelength.

Parameters: sigma_px_per_100nm, s, px per 100 nm, null value 0; it grows with the aperture's diameter.
Source: Born and Wolf, Principles of Optics: longitudinal chromatic aberration.
"""

from __future__ import annotations

import numpy as np

from ..chain import Light
from .blur import blurred
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Wavelength at which the lens is in focus, nm: the middle of 400 to 700 nm.
IN_FOCUS_NM = 550.0


def _apply(light: Light, sigma_px_per_100nm: float) -> Light:
    """Light with each band blurred as at its signal's mean wavelength."""
    sigma = sigma_px_per_100nm * np.abs(light.effective_nm - IN_FOCUS_NM) / 100.0
    return blurred(light, sigma)


EFFECT = Effect(
    id="chromatic-focus",
    stage="optics",
    title="blur that grows away from 550 nm",
    summary="The lens blurs by a Gaussian whose standard deviation grows linearly away from 550 nm. "
    "Each band has the blur of its mean wavelength.",
    parameters=(
        Parameter(
            "sigma_px_per_100nm",
            "px per 100 nm",
            null=0.0,
            high=5.0,
            low=0.0,
            step=0.15,
            grows_with_aperture=True,
        ),
    ),
    apply=_apply,
    confirm="Photograph a slanted edge in every band: the edge spread grows towards both ends of the "
    "spectrum. Refocusing one of the outer bands sharpens it.",
    sources=("Born and Wolf, Principles of Optics: longitudinal chromatic aberration",),
)
