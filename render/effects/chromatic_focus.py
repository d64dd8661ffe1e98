"""Chromatic focus: blur that grows away from one wavelength."""

from __future__ import annotations

import numpy as np

from ..chain import Light
from .blur import blurred
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Where the lens is in focus, nm.
IN_FOCUS_NM = 550.0


def _apply(light: Light, sigma_px_per_100nm: float) -> Light:
    """Each band's blur is that of its signal's mean wavelength."""
    sigma = sigma_px_per_100nm * np.abs(light.effective_nm - IN_FOCUS_NM) / 100.0
    return blurred(light, sigma)


EFFECT = Effect(
    id="chromatic-focus",
    stage="optics",
    title="blur that grows away from 550 nm",
    summary="Blur by a Gaussian whose standard deviation grows linearly away from 550 nm; each band takes "
    "that of its mean wavelength.",
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
