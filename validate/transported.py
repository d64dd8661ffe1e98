"""A rendered image under effects of light transport: their change at many wavelengths, finer than a diagnosis asks.

The diagnosis sees an effect's change through patches of a twelfth of the scene's diagonal at one wavelength a band;
here patches are nearly half as long, more is traced, with other random numbers, and spectra are followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM
from cboxlab.render.final_gather import solve_light
from cboxlab.render.image import RenderedImage
from cboxlab.render.patch_light import PatchLight, patch_light
from cboxlab.render.patch_transport import build_patch_transport
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from .effects import AppliedEffect
from .forward import after_stage

__all__ = ["transported"]

#: Steps of the wavelengths at which the change is computed (between them it is linear), where paints alone give it
#: its spectrum and where lines or bells do; so many wavelengths at once.
_EVERY_NM, _FINE_NM, _AT_ONCE = 20, 5, 16
_DARK = 1e-6
_NARROW = ("ambient-light", "fluorescence")

_PATCHES_PER_DIAGONAL, _PATCH_SAMPLES, _SAMPLES, _PICTURE_SAMPLES = 20, 1024, 512, 512


def transported(
    image: RenderedImage, scene: Scene, camera: Camera, effects: Sequence[AppliedEffect], seed: int
) -> RenderedImage:
    """The image, on WAVELENGTH_NM, as the effects of the stage "transport" change it, in their order.

    scene, camera : those of the image.
    """
    if not any(effect.effect.stage == "transport" for effect in effects):
        return image
    step = _FINE_NM if any(effect.id in _NARROW for effect in effects) else _EVERY_NM
    coarse = WAVELENGTH_NM[::step]
    extent = np.concatenate([s.vertices_mm for s in scene.surfaces])
    edge = float(np.linalg.norm(np.ptp(extent, axis=0))) / _PATCHES_PER_DIAGONAL
    other = seed ^ 0x2B7E
    field = solve_light(scene, coarse, patch_edge_mm=edge, patch_samples=_PATCH_SAMPLES, seed=other)
    transport = build_patch_transport(field, camera, _SAMPLES, other)
    lamp = scene.lamp.radiance.at(WAVELENGTH_NM)
    lamp = np.maximum(
        lamp, _DARK * lamp.max()
    )  # all is told over the lamp's radiance, which a line lamp lacks
    ratios, additions = [], []
    for some in np.array_split(coarse, -(-coarse.size // _AT_ONCE)):
        at_each = (WAVELENGTH_NM == some[:, None]).astype(float)
        light: PatchLight = patch_light(
            transport, scene, some, WAVELENGTH_NM, at_each, lamp, samples=_PICTURE_SAMPLES
        )
        before, after = light.picture(), after_stage(light, effects, "transport").picture()
        ratio, addition = _ratio_and_addition(before, after)
        ratios.append(ratio)
        additions.append(addition)
    ratio, addition = (np.moveaxis(np.concatenate(parts), 0, -1) for parts in (ratios, additions))
    between = np.array([np.interp(WAVELENGTH_NM, coarse, row) for row in np.eye(coarse.size)])
    mean = image.project(np.eye(WAVELENGTH_NM.size)[:, ::step])[0] / lamp[::step]
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
