"""The picture where nothing can be compiled: Mitsuba's own integrator from the surveyed camera, nothing refitted."""

from __future__ import annotations

import numpy as np
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_stock
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.progress import NO_PROGRESS, Progress

__all__ = ["render_plainly"]

#: Three wavelengths a render: these are ten renders. Between them radiance over the lamp's is taken as linear.
_WAVELENGTHS = np.linspace(400.0, 700.0, 30)
_SAMPLES, _BATCHES = 64, 4


def render_plainly(
    scene: Scene, camera: Camera, max_bounces: int | None, seed: int, progress: Progress = NO_PROGRESS
) -> RenderedImage:
    """The picture on WAVELENGTH_NM: correct, slow and noisy; its error is counted like any other render's."""
    image = render_stock(
        RenderJob(scene, camera, _WAVELENGTHS, _SAMPLES, _BATCHES, seed=seed, max_bounces=max_bounces),
        progress=progress,
    )
    between = np.array([np.interp(WAVELENGTH_NM, _WAVELENGTHS, row) for row in np.eye(len(_WAVELENGTHS))])
    return RenderedImage(
        coefficients=image.coefficients,
        spectra=between * scene.lamp_radiance(WAVELENGTH_NM),
        wavelength_nm=WAVELENGTH_NM,
        coverage=image.coverage,
        facet_surface=image.facet_surface,
        surface_names=image.surface_names,
    )
