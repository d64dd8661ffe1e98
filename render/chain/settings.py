"""Settings of the rendering of a model: noise, reflections, random numbers."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RenderSettings"]


@dataclass(frozen=True)
class RenderSettings:
    """Settings of a rendering."""

    #: Standard deviation of the rendering over that of the sensor, median over pixels and bands, at which rendering
    #: ends.
    noise: float = 0.3
    #: Largest number of reflections between lamp and camera; None for no limit.
    max_bounces: int | None = None
    #: Seed of every random number.
    seed: int = 0
