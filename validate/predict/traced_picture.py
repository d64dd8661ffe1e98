"""Rendering by path tracing of a scene that is not Lambertian or that holds a medium.

The Lambertian rendering gives the spectra at all wavelengths; the difference of the traced paths from it is added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_image
from cboxlab.rendering.radiosity import LightField, gather
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.progress import Progress

from .rendering import Picture

__all__ = ["traced_picture"]

#: Wavelengths of traced paths, nm. Between them the difference from the Lambertian picture over the lamp is linear.
_TRACED_NM = np.linspace(WAVELENGTH_NM[0], WAVELENGTH_NM[-1], 31)

#: Samples of the Lambertian picture: its noise is below that of the paths.
_SAMPLES = 256

#: Parts of a batch of paths: from few batches, the error is too uncertain in comparison with the sensor's noise.
_PARTS = 4


def traced_picture(scene: Scene, camera: Camera, light: LightField, settings: RenderSettings) -> Picture:
    """Renderer of a scene by path tracing.

    Parameters
    ----------
    scene
        Scene with its BSDFs and medium.
    camera
        Camera of the pictures.
    light
        Radiosity solution of the same scene by Lambert's law alone.
    settings
        Seed and depth of paths.

    Returns
    -------
    Picture
        Renders a picture for samples per batch, first batch, batches and a callback for progress.
    """
    shape = gather(light, camera, _SAMPLES, 1, settings.seed)
    lamp = scene.lamp_radiance(WAVELENGTH_NM)
    at = np.searchsorted(WAVELENGTH_NM, _TRACED_NM)
    at = at[lamp[at] > 0]
    traced_nm = WAVELENGTH_NM[at]
    lambertian = shape.coefficients[0] @ shape.spectra[:, at]
    between = np.array([np.interp(WAVELENGTH_NM, traced_nm, row) for row in np.eye(at.size)])

    def picture(samples: int, first_batch: int, batches: int, report: Progress) -> RenderedImage:
        traced = render_image(
            RenderJob(
                scene,
                camera,
                traced_nm,
                samples // _PARTS,
                batches * _PARTS,
                seed=settings.seed,
                max_bounces=settings.max_bounces,
                first_batch=first_batch * _PARTS,
            ),
            progress=report,
        )
        beyond = ((batch @ traced.spectra - lambertian) / lamp[at] for batch in traced.coefficients)
        parts = [np.concatenate([shape.coefficients[0], part], axis=-1, dtype=np.float32) for part in beyond]
        return replace(shape, coefficients=np.stack(parts), spectra=np.concatenate([shape.spectra, between * lamp]))

    return picture
