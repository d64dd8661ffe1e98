"""A model's chain forwards: its effects stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import xarray as xr
from cboxlab.render.image import RenderedImage
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.scene_file import load_scene
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

from .effects import AppliedEffect, Stage
from .model import Model

__all__ = ["after_stage", "displacement", "labelled_cube", "model_cube_inputs"]

Value = TypeVar("Value")


def after_stage(value: Value, effects: Sequence[AppliedEffect], stage: Stage) -> Value:
    """A stage's value after all effects of that stage, in their order."""
    for effect in effects:
        if effect.effect.stage == stage:
            value = effect.apply(value)
    return value


def displacement(
    camera: Camera, before: Sequence[AppliedEffect], effects: Sequence[AppliedEffect]
) -> NDArray[np.float64]:
    """(10,) change of a camera's parameters by effects that act on it after others."""
    camera = after_stage(camera, before, "camera")
    return np.asarray(after_stage(camera, effects, "camera").parameters - camera.parameters)


def model_cube_inputs(
    model: Model, camera: Camera, lamp: Spectrum | None = None
) -> tuple[Scene, Camera, int | None]:
    """Scene, camera and most bounces of a model's spectral cube: everything before filters and sensor.

    lamp : spectral radiance in place of that of the model's scene.
    """
    settings = after_stage(model.render, model.effects, "settings")
    scene = load_scene(model.scene)
    scene = after_stage(scene if lamp is None else scene.with_lamp(lamp), model.effects, "scene")
    return scene, after_stage(camera, model.effects, "camera"), settings.max_bounces


def labelled_cube(image: RenderedImage) -> xr.Dataset:
    """The image's cube; the attribute ``batches`` of its standard error says how well that is known."""
    cube = image.cube()
    cube["standard_error"].attrs["batches"] = len(image.coefficients)
    return cube
