"""Effects of light transport on a rendered image, for spectral cubes and synthetic captures.

The diagnosis computes an effect's change with patches of a twelfth of the scene's diagonal at one wavelength per band.
Here patches are a twentieth of it, with more rays, other random numbers, and wavelengths in steps of each effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cboxlab.rendering.chain import after_stage
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.perturbation import PatchLight, build_patch_transport, patch_light
from cboxlab.rendering.radiosity import build_patched_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

__all__ = ["transported"]

#: Wavelengths computed together.
_AT_ONCE = 16

#: Least share of the lamp's largest radiance that light is divided by: a lamp of lines is dark between them.
_DARK = 1e-6

#: Patches along the scene's diagonal: finer than the twelve of the diagnosis, whose errors a test must not share.
_PATCHES_PER_DIAGONAL = 20

#: Rays from each patch.
_PATCH_SAMPLES = 1024

#: Rays of each pixel for its patches.
_SAMPLES = 512

#: Rays of each pixel for light that patches do not describe.
_PICTURE_SAMPLES = 512


def transported(
    image: RenderedImage,
    scene: Scene,
    camera: Camera,
    effects: Sequence[AppliedEffect],
    seed: int,
    max_bounces: int | None = None,
) -> RenderedImage:
    """Image changed by the effects of the stage "transport", in their order.

    Parameters
    ----------
    image
        The rendered image.
    scene
        Scene of the image.
    camera
        Camera of the image.
    effects
        Effects; those of other stages do not count.
    seed
        Seed of the image: the transport has other random numbers.
    max_bounces
        Most reflections of the image; None for no limit.

    Returns
    -------
    RenderedImage
        The image with the change as further coefficients and spectra; the image itself without such effects.
    """
    steps = [effect.effect.spectral_step_nm for effect in effects if effect.stage == "transport"]
    if not steps:
        return image
    grid = np.arange(min(400.0, np.floor(image.wavelength_nm[0])), max(700.0, image.wavelength_nm[-1]) + 1.0)
    every = _thinned(image.wavelength_nm, min(steps))
    coarse = image.wavelength_nm[every]
    at_coarse = np.array([np.interp(coarse, grid, row) for row in np.eye(grid.size)]).T
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    other = seed ^ 0x2B7E
    patched = build_patched_scene(scene, edge, _PATCH_SAMPLES, other)
    transport = build_patch_transport(patched, camera, _SAMPLES, other)
    lamp, own_lamp = (scene.lamp_radiance(nm) for nm in (grid, image.wavelength_nm))
    dark = _DARK * lamp.max()  # light is divided by the lamp's radiance, which is 0 between the lines of a lamp
    lamp, own_lamp = np.maximum(lamp, dark), np.maximum(own_lamp, dark)
    ratios, additions = [], []
    parts = -(-coarse.size // _AT_ONCE)
    for some, at_each in zip(np.array_split(coarse, parts), np.array_split(at_coarse, parts), strict=True):
        light: PatchLight = patch_light(
            transport, scene, some, grid, at_each, lamp, max_bounces=max_bounces, samples=_PICTURE_SAMPLES
        )
        before, after = light.picture(), after_stage(light, effects, "transport").picture()
        ratio, addition = _ratio_and_addition(before, after)
        ratios.append(ratio)
        additions.append(addition)
    ratio, addition = (np.moveaxis(np.concatenate(parts), 0, -1) for parts in (ratios, additions))
    between = np.array([np.interp(image.wavelength_nm, coarse, row) for row in np.eye(coarse.size)])
    mean = image.project(np.eye(image.wavelength_nm.size)[:, every])[0] / own_lamp[every]
    change = (mean * (ratio - 1) + addition).astype(np.float32)
    return replace(
        image,
        coefficients=np.concatenate(
            [image.coefficients, np.broadcast_to(change, (len(image.coefficients), *change.shape))], axis=-1
        ),
        spectra=np.concatenate([image.spectra, between * own_lamp]),
    )


def _thinned(wavelength_nm: NDArray[np.float64], step_nm: float) -> NDArray[np.int64]:
    """Indices of wavelengths ``step_nm`` apart or more, first and last included."""
    targets = np.arange(wavelength_nm[0], wavelength_nm[-1] + step_nm, step_nm)
    nearest = np.abs(wavelength_nm[:, None] - np.minimum(targets, wavelength_nm[-1])).argmin(axis=0)
    return np.unique(nearest)


def _ratio_and_addition(before: NDArray, after: NDArray) -> tuple[NDArray, NDArray]:
    """Factor on the accurate picture; light added where it is not within 0.5 to 2 (dark)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after / before
    steady = np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0)
    return np.where(steady, ratio, 1.0), np.where(steady, 0.0, after - before)
