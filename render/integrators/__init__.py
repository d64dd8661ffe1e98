"""The integrators, the choice among them, and rendering to a stated error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from ..image import RenderJob
    from .choice import render_image
    from .passes import TIMEOUT_S
    from .precision import (
        BATCHES,
        MOST_PASSES,
        fireflies,
        relative_error,
        relative_errors,
        render_passes,
        render_to_precision,
    )
    from .stock import render_stock

__all__ = [
    "BATCHES",
    "MOST_PASSES",
    "TIMEOUT_S",
    "RenderJob",
    "fireflies",
    "relative_error",
    "relative_errors",
    "render_image",
    "render_passes",
    "render_stock",
    "render_to_precision",
]

__getattr__, __dir__ = lazy_names(__name__)
