"""Rendering without a compiled variant, by Mitsuba's own integrator.

It takes longer and is noisier than the rendering from patches, and the camera is the surveyed one without a refit.
"""

from __future__ import annotations

import numpy as np
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_stock
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.progress import NO_PROGRESS, Progress

__all__ = ["render_plainly"]

#: Wavelengths rendered, nm: three for each of ten renderings. Between them radiance over the lamp's is linear.
_WAVELENGTHS = np.linspace(400.0, 700.0, 30)

#: Samples per pixel and batch. The noise of the picture is much larger than with a compiled variant.
_SAMPLES = 64

#: Batches, from whose scatter the error is estimated.
_BATCHES = 4


def render_plainly(
    scene: Scene, camera: Camera, max_bounces: int | None, seed: int, progress: Progress = NO_PROGRESS
) -> RenderedImage:
    """Render a scene with Mitsuba's path integrator.

    Its Monte Carlo error is counted like that of any other rendering.

    Parameters
    ----------
    scene
        Scene with its lamps.
    camera
        Camera of the picture.
    max_bounces
        Most reflections of a path; None for no limit.
    seed
        Seed of the random numbers.
    progress
        Called with the completed share.

    Returns
    -------
    RenderedImage
        Picture on WAVELENGTH_NM.
    """
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
