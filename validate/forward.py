"""A model's chain forwards: its effects stage by stage, and renders down to a stated relative error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.render.image import RenderedImage
from cboxlab.render.integrators import render
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.scene_file import load_scene
from numpy.typing import NDArray

from .effects import AppliedEffect, Stage
from .model import Model
from .rendering import BATCHES, CONVERGENCE, PILOT_SAMPLES

__all__ = ["BATCHES", "after_stage", "labelled_cube", "model_cube_inputs", "render_to_precision"]

#: The most samples of one batch.
MOST_SAMPLES = 2**15


def after_stage(value: Any, effects: Sequence[AppliedEffect], stage: Stage) -> Any:
    """A stage's value after all effects of that stage, in their order."""
    for effect in effects:
        if effect.effect.stage == stage:
            value = effect.apply(value)
    return value


def model_cube_inputs(model: Model, camera: Camera) -> tuple[Scene, Camera, int | None]:
    """Scene, camera and most bounces of a model's spectral cube: everything before filters and sensor."""
    settings = after_stage(model.render, model.effects, "settings")
    scene = after_stage(load_scene(model.scene), model.effects, "scene")
    return scene, after_stage(camera, model.effects, "camera"), settings.max_bounces


def labelled_cube(image: RenderedImage) -> xr.Dataset:
    """The image's cube; the attribute ``batches`` of its standard error says how well that is known."""
    cube = image.cube()
    cube["standard_error"].attrs["batches"] = len(image.coefficients)
    return cube


def _relative_error(image: RenderedImage) -> float:
    """Median of standard error over radiance, over pixels that see surfaces and about 30 wavelengths."""
    every = max(1, image.wavelength_nm.size // 30)
    mean, variance = image.project(np.eye(image.wavelength_nm.size)[:, ::every])
    lit = (mean > 0) & (image.coverage[..., :-1].sum(axis=-1) > 0)[..., None]
    return float(np.median(np.sqrt(variance[lit]) / mean[lit])) if lit.any() else 0.0


def render_to_precision(
    scene: Scene,
    camera: Camera,
    wavelength_nm: NDArray[np.float64],
    relative_error: float,
    max_bounces: int | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> RenderedImage:
    """Render until the median relative standard error of a pixel's radiance is ``relative_error``.

    A trial of few samples tells how many it takes; never more than MOST_SAMPLES per pixel and batch.
    """
    image = render(scene, camera, wavelength_nm, PILOT_SAMPLES, BATCHES, seed, max_bounces)
    wanted = PILOT_SAMPLES * (_relative_error(image) / relative_error) ** (1 / CONVERGENCE)
    samples = int(min(2 ** np.ceil(np.log2(max(wanted, 1.0))), MOST_SAMPLES))
    if samples <= PILOT_SAMPLES:
        return image
    return render(scene, camera, wavelength_nm, samples, BATCHES, seed, max_bounces, progress)
