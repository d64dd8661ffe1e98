"""Our picture of a scene that is not Lambertian, or that holds a medium: all its paths are traced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render
from cboxlab.rendering.radiosity import LightField, gather
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.progress import Progress

from .rendering import Picture

__all__ = ["traced_picture"]

#: Where paths are traced. Between, what they differ from the Lambertian picture by is linear, relative to the lamp.
_TRACED_NM = np.linspace(WAVELENGTH_NM[0], WAVELENGTH_NM[-1], 31)

#: Of the Lambertian picture.
_SAMPLES = 256

#: A batch of paths is divided into so many: the error of few batches is too uncertain beside the sensor's noise.
_PARTS = 4


def traced_picture(scene: Scene, camera: Camera, light: LightField, settings: RenderSettings) -> Picture:
    """Pictures of a scene through a camera. light : the solution of the same scene by Lambert's law alone."""
    shape = gather(light, camera, _SAMPLES, 1, settings.seed)
    lamp = scene.lamp_radiance(WAVELENGTH_NM)
    at = np.searchsorted(WAVELENGTH_NM, _TRACED_NM)
    at = at[lamp[at] > 0]
    traced_nm = WAVELENGTH_NM[at]
    lambertian = shape.coefficients[0] @ shape.spectra[:, at]
    between = np.array([np.interp(WAVELENGTH_NM, traced_nm, row) for row in np.eye(at.size)])

    def picture(samples: int, batches: int, report: Progress) -> RenderedImage:
        traced = render(
            RenderJob(
                scene,
                camera,
                traced_nm,
                samples // _PARTS,
                batches * _PARTS,
                seed=settings.seed,
                max_bounces=settings.max_bounces,
            ),
            progress=report,
        )
        beyond = ((batch @ traced.spectra - lambertian) / lamp[at] for batch in traced.coefficients)
        parts = [np.concatenate([shape.coefficients[0], one], axis=-1, dtype=np.float32) for one in beyond]
        return replace(shape, coefficients=np.stack(parts), spectra=np.concatenate([shape.spectra, between * lamp]))

    return picture
