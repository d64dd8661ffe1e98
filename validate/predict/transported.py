"""Effects of light transport on a rendered image, for spectral cubes and synthetic captures.

The diagnosis computes an effect's change with patches of a twelfth of the scene's diagonal at one wavelength per band.
Here patches are a twentieth of it, with more rays, other random numbers, and wavelengths in steps of each effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.chain import after_stage
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.perturbation import PatchLight, build_patch_transport, patch_light
from cboxlab.rendering.radiosity import build_patched_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

__all__ = ["Coated", "coated", "transported"]

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


@dataclass(frozen=True, eq=False)
class Coated:
    """An image with effects of light transport, and what coats do to it."""

    #: The image with all effects.
    image: RenderedImage
    #: The image with coats as the only effects.
    coats: RenderedImage
    #: (y, x, w) radiance that coats reflect at the surfaces seen, W m^-2 sr^-1 nm^-1.
    specular: NDArray[np.float64]


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
    return _changed(image, scene, camera, (effects,), seed, max_bounces)[0][0]


def coated(
    image: RenderedImage,
    scene: Scene,
    camera: Camera,
    effects: Sequence[AppliedEffect],
    seed: int,
    max_bounces: int | None = None,
) -> Coated:
    """Image as of ``transported``, with the change by coats apart.

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
        Seed of the image.
    max_bounces
        Most reflections of the image; None for no limit.

    Returns
    -------
    Coated
        The images and the coats' light.
    """
    coats = [effect for effect in effects if effect.effect.is_coat]
    others = [effect for effect in effects if effect.stage == "transport" and not effect.effect.is_coat]
    if not coats:
        none = np.zeros((*image.coefficients.shape[1:3], image.wavelength_nm.size))
        return Coated(transported(image, scene, camera, effects, seed, max_bounces), image, none)
    sets = (effects, coats) if others else (coats,)
    images, specular = _changed(image, scene, camera, sets, seed, max_bounces, apart=True)
    return Coated(images[0], images[-1], specular)


def _changed(
    image: RenderedImage,
    scene: Scene,
    camera: Camera,
    sets: Sequence[Sequence[AppliedEffect]],
    seed: int,
    max_bounces: int | None,
    *,
    apart: bool = False,
) -> tuple[list[RenderedImage], NDArray[np.float64]]:
    """Image changed by each of some sets of effects, and the coats' light of the last set.

    The coats' light is 0 unless it is wanted ``apart``.
    """
    effects = sets[0]
    steps = [effect.effect.spectral_step_nm for effect in effects if effect.stage == "transport"]
    if not steps:
        return [image], np.zeros(0)
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
    changes: list[list[NDArray]] = [[] for _ in sets]
    speculars: list[NDArray] = []
    parts = -(-coarse.size // _AT_ONCE)
    for some, at_each in zip(np.array_split(coarse, parts), np.array_split(at_coarse, parts), strict=True):
        light: PatchLight = patch_light(
            transport, scene, some, grid, at_each, lamp, max_bounces=max_bounces, samples=_PICTURE_SAMPLES
        )
        before = light.picture()
        after = light.change(specular=np.zeros_like(light.added)) if apart else light
        for each, ratios_and_additions in zip(sets, changes, strict=True):
            changed = after_stage(after, each, "transport")
            ratios_and_additions.append(np.stack(_ratio_and_addition(before, changed.picture())))
        speculars.append(np.zeros_like(light.added) if changed.specular is None else changed.specular)
    between = np.array([np.interp(image.wavelength_nm, coarse, row) for row in np.eye(coarse.size)])
    mean = image.project(np.eye(image.wavelength_nm.size)[:, every])[0] / own_lamp[every]
    spectra = between * own_lamp
    images = []
    for ratios_and_additions in changes:
        ratio, addition = np.moveaxis(np.concatenate(ratios_and_additions, axis=1), 1, -1)
        images.append(_with_change(image, (mean * (ratio - 1) + addition).astype(np.float32), spectra))
    return images, np.moveaxis(np.concatenate(speculars), 0, -1) @ spectra


def _with_change(image: RenderedImage, change: NDArray[np.float32], spectra: NDArray[np.float64]) -> RenderedImage:
    """Image with (y, x, k) further coefficients, alike in all batches, and their (k, w) spectra."""
    added = np.broadcast_to(change, (len(image.coefficients), *change.shape))
    return replace(
        image,
        coefficients=np.concatenate([image.coefficients, added], axis=-1),
        spectra=np.concatenate([image.spectra, spectra]),
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
