"""An image with its exact derivatives by reflectances and by the lamps' radiance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..image import RenderedImage, RenderJob
from ..visibility import build_tracer, facet_coverage
from .path_tracer import trace_paths

__all__ = ["Derivatives", "render_derivatives"]


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the radiance at each wavelength, in the batches of the image."""

    #: The image, which equals its derivative by a factor on the lamps' power.
    image: RenderedImage
    #: (m,) names of the materials.
    material_names: tuple[str, ...]
    #: (batch, m, y, x, w) derivative by each material's reflectance at the same wavelength, W m^-2 sr^-1 nm^-1.
    #: Reflectances at other wavelengths have no influence.
    reflectance: NDArray[np.float32]
    #: (batch, y, x, w) derivative by the lamps' mean radiance, at fixed shares of each lamp in it.
    lamp: NDArray[np.float32]


def render_derivatives(
    job: RenderJob,
    progress: Progress = NO_PROGRESS,
) -> Derivatives:
    """Image of a diffuse scene by path tracing, with its derivatives from the same paths.

    The throughput of a path reflected n times by a material of reflectance rho contains rho^n, so its derivative is its
    light times n / rho. The probabilities of Russian roulette are held fixed, so the result is the exact derivative of
    the estimate.

    Parameters
    ----------
    job
        The image to render.
    progress
        Receives the completed share after each kernel call.

    Returns
    -------
    Derivatives
        The image of `render_path_tracer`, and its derivatives.

    Raises
    ------
    InputError
        For a scene that is not diffuse, and for a reflectance of 0, at which no path contributes.
    """
    scene, wavelengths = job.scene, job.wavelength_nm
    scene.require_diffuse()
    reflectances = scene.reflectances(wavelengths)[: len(scene.materials)]
    for name, row in zip(scene.materials, reflectances, strict=True):
        if row.min() <= 0:
            where = f"{wavelengths[row.argmin()]:g} nm"
            raise InputError(f"material {name}", f"reflectance 0 at {where}", "more than 0, for derivatives")
    tracer = build_tracer(scene)
    sums = trace_paths(tracer, job, progress, counted=True)
    lamp, shares, count = scene.lamp_radiance(wavelengths), scene.lamp_shares(wavelengths), len(wavelengths)
    emitted, reflected, counted = np.split(sums, [len(shares), len(shares) + count], axis=-1)
    image = RenderedImage(
        coefficients=sums[..., : len(shares) + count],
        spectra=np.vstack([shares * lamp, np.diag(lamp)]),
        wavelength_nm=wavelengths,
        coverage=facet_coverage(tracer, job.camera),
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )
    counted = counted.reshape(*sums.shape[:3], len(reflectances), count)
    return Derivatives(
        image,
        tuple(scene.materials),
        reflectance=np.moveaxis(counted * (lamp / reflectances).astype(np.float32), 3, 1),
        lamp=emitted @ shares.astype(np.float32) + reflected,
    )
