"""The integrators, the choice among them, and rendering to a stated error."""

from .choice import render
from .precision import BATCHES, fireflies, relative_error, render_to_precision
from .stock import render_stock

__all__ = [
    "BATCHES",
    "fireflies",
    "relative_error",
    "render",
    "render_stock",
    "render_to_precision",
]
