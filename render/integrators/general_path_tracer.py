"""Path tracer for any scene: textures, coatings, glass, metals and media.

All wavelengths share each path, as in `path_tracer`; see `path_kernel` for the estimator.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import mi
from ..image import RenderedImage, RenderJob, means_by_strips
from ..materials import SpectralBsdfs, SpectralMedia, SpectralTextures
from ..radiosity import build_lamp_samplers
from ..visibility import build_tracer, facet_coverage
from .path_kernel import Contents, PathKernel

__all__ = ["render_general_path_tracer"]


def render_general_path_tracer(job: RenderJob, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """Image of any scene by path tracing.

    Supports textures on Lambertian surfaces, any BSDF of Mitsuba, and media, around the surfaces and inside closed
    ones. A scattering counts as a bounce, a boundary without refraction ("null") does not. The coefficients are
    radiance relative to the lamps' mean (`Scene.lamp_radiance`).

    Parameters
    ----------
    job
        The image to render.
    progress
        Receives the completed share after each kernel call.

    Returns
    -------
    RenderedImage
        Image with one coefficient per wavelength.

    Raises
    ------
    InputError
        For a material that Mitsuba does not support.
    """
    scene, wavelengths = job.scene, job.wavelength_nm
    compiled = "cuda_ad_spectral" if mi.variant().startswith("cuda") else "llvm_ad_spectral"
    with mi.scoped_set_variant(compiled):
        tracer = build_tracer(scene)
        lamps = build_lamp_samplers(tracer)
        bsdfs = SpectralBsdfs(scene, wavelengths)
        textures = SpectralTextures(tracer, wavelengths)
        filled = scene.medium is not None or any(s.inside is not None for s in scene.surfaces) or bsdfs.passing
        media = SpectralMedia(tracer, wavelengths) if filled else None
        contents = Contents(bsdfs, textures, media)

        def strip(pixels: mi.UInt32, lane_samples: int, seeds: mi.UInt32) -> list[mi.Float]:
            return PathKernel(tracer, lamps, contents, job, pixels, samples=lane_samples, seeds=seeds).sums()

        coefficients = means_by_strips(strip, job, progress)
        coverage = facet_coverage(tracer, job.camera)
    return RenderedImage(
        coefficients=coefficients,
        spectra=np.diag(scene.lamp_radiance(wavelengths)),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )
