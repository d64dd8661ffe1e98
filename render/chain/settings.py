"""How a model is rendered: to which noise, over how many reflections, from which random numbers."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RenderSettings"]


@dataclass(frozen=True)
class RenderSettings:
    """noise : render's standard deviation over the sensor's, median over pixels and bands, to render down to.

    max_bounces : reflections between lamp and camera, None for all. seed : of every random number.
    """

    noise: float = 0.3
    max_bounces: int | None = None
    seed: int = 0
