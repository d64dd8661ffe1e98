"""Rendering with a chosen integrator, or with the best one available."""

from __future__ import annotations

import logging
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

__all__ = ["Integrator", "render_image"]

_log = logging.getLogger(__name__)

#: Names of the integrators.
Integrator = Literal["default", "final-gather", "path", "stock"]


def render_image(
    job: RenderJob,
    *,
    progress: Progress = NO_PROGRESS,
    integrator: Integrator = "default",
) -> RenderedImage:
    """Render an image; the integrators agree within their standard errors.

    "default" is the final gather. "path" is the path tracer. For scenes with textures, surfaces that are not
    Lambertian, or a medium, the general path tracer replaces both. "final-gather" is the final gather in any case.
    "stock" is Mitsuba's own integrator; it replaces all others, with a warning, if no compiled variant is available.

    Parameters
    ----------
    job
        The image to render.
    progress
        Receives the completed share, 0 to 1.
    integrator
        Name of the integrator.

    Returns
    -------
    RenderedImage
        The image.

    Raises
    ------
    InputError
        If the integrator does not support the scene.
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
    _log.info("integrator %s: %s", integrator, integrators[integrator].__name__)
    return integrators[integrator](job, progress=progress)
