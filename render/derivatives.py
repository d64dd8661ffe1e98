"""The picture and its exact derivatives by paints and lamp, from the same paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from .image import RenderedImage
from .path_tracer import trace_paths
from .primary import facet_coverage
from .tracer import build_tracer

__all__ = ["Derivatives", "render_derivatives"]


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Of the radiance at each wavelength, in the batches of the image.

    image : the picture itself, which is also its derivative by a factor on the lamp's power.
    reflectance : (batch, material, y, x, w) by each paint's reflectance at the same wavelength; other
        wavelengths have no part in it. material_names : (m,). lamp : (batch, y, x, w) by the lamp's radiance.
    """

    image: RenderedImage
    material_names: tuple[str, ...]
    reflectance: NDArray[np.float32]
    lamp: NDArray[np.float32]


def render_derivatives(
    scene: Scene,
    camera: Camera,
    wavelength_nm: np.ndarray,
    samples: int = 256,
    batches: int = 4,
    seed: int = 0,
    max_bounces: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Derivatives:
    """Render the scene with its derivatives; arguments as ``render_path_tracer``, whose picture this is.

    A path that was reflected n times by a paint of reflectance rho carries rho^n, so its light times n / rho is
    its derivative: counting is all it takes. Roulette goes by probabilities that are held fixed, so
    the result is the exact derivative of the estimate. Raises InputError for a scene that is not diffuse or a
    reflectance of 0, to which no path tells a change.
    """
    if not scene.diffuse:
        raise InputError(f"scene {scene.name}", "a surface or medium that is not diffuse", "a diffuse scene")
    wavelengths = np.asarray(wavelength_nm, float)
    reflectances = np.array([m.reflectance.at(wavelengths) for m in scene.materials.values()])
    for name, row in zip(scene.materials, reflectances, strict=True):
        if row.min() <= 0:
            where = f"{wavelengths[row.argmin()]:g} nm"
            raise InputError(f"material {name}", f"reflectance 0 at {where}", "more than 0, for derivatives")
    tracer = build_tracer(scene)
    sums = trace_paths(
        tracer, camera, wavelengths, samples, batches, seed, max_bounces, progress, counted=True
    )
    lamp, count = scene.lamp.radiance.at(wavelengths), len(wavelengths)
    image = RenderedImage(
        coefficients=sums[..., : 1 + count],
        spectra=np.vstack([lamp, np.diag(lamp)]),
        wavelength_nm=wavelengths,
        coverage=facet_coverage(tracer, camera),
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )
    counted = sums[..., 1 + count :].reshape(*sums.shape[:3], len(reflectances), count)
    return Derivatives(
        image,
        tuple(scene.materials),
        reflectance=np.moveaxis(counted * (lamp / reflectances).astype(np.float32), 3, 1),
        lamp=sums[..., :1] + sums[..., 1 : 1 + count],
    )
