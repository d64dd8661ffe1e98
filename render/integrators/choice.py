"""Renders an image with a chosen integrator, or with the best one available."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Literal

from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import variant
from ..image import RenderedImage, RenderJob
from ..radiosity import render_final_gather
from .general_path_tracer import render_general_path_tracer
from .path_tracer import render_path_tracer
from .stock import render_stock

__all__ = ["Integrator", "render"]

Integrator = Literal["default", "final-gather", "path", "stock"]


def render(
    job: RenderJob,
    *,
    progress: Progress = NO_PROGRESS,
    integrator: Integrator = "default",
) -> RenderedImage:
    """Render the scene through the camera; the integrators agree within their standard errors.

    wavelength_nm : (w,) at which reflectances and lamp are evaluated. samples : per pixel and batch; of each pixel
    where (y, x). batches : independent randomisations, whose scatter gives the standard error. max_bounces : largest
    number of reflections between lamp and camera (0 the visible lamp, 1 direct light; None for no limit). seed :
    results are repeatable.
    progress : called with the completed share, 0 to 1. integrator : "default" is the final gather, or, with a
    warning, Mitsuba's own integrator ("stock") if no compiled variant is available. For scenes with non-Lambertian
    surfaces or a medium, the general path tracer replaces the final gather and "path".
    """
    if not variant.compiled() and integrator != "stock":
        warnings.warn(variant.HINT, RuntimeWarning, stacklevel=2)
        integrator = "stock"
    integrators: dict[str, Callable[..., RenderedImage]] = {
        "default": render_final_gather if job.scene.diffuse else render_general_path_tracer,
        "final-gather": render_final_gather,
        "path": render_path_tracer if job.scene.diffuse else render_general_path_tracer,
        "stock": render_stock,
    }
    return integrators[integrator](job, progress=progress)
