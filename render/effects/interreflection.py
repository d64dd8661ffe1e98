"""Interreflection: light is reflected more often than the model computes.

The number of reflections between lamp and camera becomes max_bounces; the sum of Neumann's series ends there. A real
box has no limit. The cause of a difference is a model that stops early.

Parameters: max_bounces, number of reflections, rounded; no null value, but the model's own number changes nothing.
Source: Goral et al. 1984, Modeling the interaction of light between diffuse surfaces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import RenderSettings
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(settings: RenderSettings, max_bounces: float) -> RenderSettings:
    """Settings with the rounded number of bounces; None, which is all light, for infinity."""
    return replace(settings, max_bounces=round(max_bounces) if np.isfinite(max_bounces) else None)


EFFECT = Effect(
    id="interreflection",
    stage="settings",
    title="light bounces more often than in the model",
    summary="Light is reflected max_bounces times between lamp and camera; in a real box the number has no limit. "
    "The effect does nothing at the model's number.",
    parameters=(Parameter("max_bounces", "1", low=0.0, high=np.inf, step=1.0, default=np.inf, example=2.0),),
    apply=_apply,
    confirm="Line one wall with black velvet: the light that it sent to the others disappears from the photograph, "
    "and this difference with it.",
    sources=("Goral et al. 1984, Modeling the interaction of light between diffuse surfaces",),
)
