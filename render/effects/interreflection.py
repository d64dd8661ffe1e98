"""Interreflection: light bounces on where the model stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import RenderSettings
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(settings: RenderSettings, max_bounces: float) -> RenderSettings:
    """inf is all light; other values are rounded to whole bounces."""
    return replace(settings, max_bounces=round(max_bounces) if np.isfinite(max_bounces) else None)


EFFECT = Effect(
    id="interreflection",
    stage="settings",
    title="light bounces on where the model stops",
    summary="Light bounces on where the model stopped: max_bounces reflections between lamp and camera, "
    "infinite in a real box. It does nothing at the model's own number.",
    parameters=(Parameter("max_bounces", "1", low=0.0, high=np.inf, step=1.0, default=np.inf, example=2.0),),
    apply=_apply,
    confirm="Line one wall with black velvet: what it sent to the others disappears from the picture, and "
    "with it this difference.",
    sources=("Goral et al. 1984, Modeling the interaction of light between diffuse surfaces",),
)
