"""A rendered image under effects of light transport, at many wavelengths, for synthetic captures.

The diagnosis computes an effect's change with patches of a twelfth of the scene's diagonal at one wavelength per band.
Here patches are a twentieth of it, with more rays, other random numbers, and wavelengths in steps of each effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cboxlab.render.chain import after_stage
from cboxlab.render.image import RenderedImage
from cboxlab.render.perturbation import PatchLight, build_patch_transport, patch_light
from cboxlab.render.radiosity import build_patched_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from ..effects import AppliedEffect

__all__ = ["transported"]

#: Wavelengths computed together.
_AT_ONCE = 16
_DARK = 1e-6

_PATCHES_PER_DIAGONAL, _PATCH_SAMPLES, _SAMPLES, _PICTURE_SAMPLES = 20, 1024, 512, 512


def transported(
    image: RenderedImage, scene: Scene, camera: Camera, effects: Sequence[AppliedEffect], seed: int
) -> RenderedImage:
    """The image, on WAVELENGTH_NM, as the effects of the stage "transport" change it, in their order.

    scene, camera : those of the image.
    """
    steps = [effect.effect.spectral_step_nm for effect in effects if effect.stage == "transport"]
    if not steps:
        return image
    step = min(steps)
    every = np.eye(INTEGRAL_GRID.count)[::step]
    coarse = WAVELENGTH_NM[::step]
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    other = seed ^ 0x2B7E
    patched = build_patched_scene(scene, edge, _PATCH_SAMPLES, other)
    transport = build_patch_transport(patched, camera, _SAMPLES, other)
    lamp = scene.lamp_radiance(WAVELENGTH_NM)
    lamp = np.maximum(
        lamp, _DARK * lamp.max()
    )  # all is told over the lamp's radiance, which a line lamp lacks
    ratios, additions = [], []
    parts = -(-coarse.size // _AT_ONCE)
    for some, at_each in zip(np.array_split(coarse, parts), np.array_split(every, parts), strict=True):
        light: PatchLight = patch_light(
            transport, scene, some, WAVELENGTH_NM, at_each, lamp, samples=_PICTURE_SAMPLES
        )
        before, after = light.picture(), after_stage(light, effects, "transport").picture()
        ratio, addition = _ratio_and_addition(before, after)
        ratios.append(ratio)
        additions.append(addition)
    ratio, addition = (np.moveaxis(np.concatenate(parts), 0, -1) for parts in (ratios, additions))
    between = np.array([np.interp(WAVELENGTH_NM, coarse, row) for row in np.eye(coarse.size)])
    mean = image.project(every.T)[0] / lamp[::step]
    change = (mean * (ratio - 1) + addition).astype(np.float32)
    return replace(
        image,
        coefficients=np.concatenate(
            [image.coefficients, np.broadcast_to(change, (len(image.coefficients), *change.shape))], axis=-1
        ),
        spectra=np.concatenate([image.spectra, between * lamp]),
    )


def _ratio_and_addition(before: NDArray, after: NDArray) -> tuple[NDArray, NDArray]:
    """What the accurate picture is multiplied by, and what is added where there was next to nothing before."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after / before
    steady = np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0)
    return np.where(steady, ratio, 1.0), np.where(steady, 0.0, after - before)
