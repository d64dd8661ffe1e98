"""What a model's effects make of scene, settings and camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

from ..chain import after_stage
from ..effects import AppliedEffect
from ..image import RenderedImage
from .model_file import Model

__all__ = ["displacement", "labelled_cube", "model_cube_inputs", "seen_through", "with_further_distortion"]


def displacement(
    camera: Camera, before: Sequence[AppliedEffect], effects: Sequence[AppliedEffect]
) -> NDArray[np.float64]:
    """(10,) change of the camera's parameters by ``effects``, which act after the effects ``before``."""
    both = seen_through(camera, (*before, *effects)), seen_through(camera, before)
    return np.asarray(both[0].parameters - both[1].parameters)


def seen_through(camera: Camera, effects: Sequence[AppliedEffect]) -> Camera:
    """The camera that effects make of one, its ten parameters as close to it as they can be."""
    return after_stage(camera, effects, "camera").closest_parameters()


def with_further_distortion(camera: Camera, effects: Sequence[AppliedEffect]) -> Camera:
    """The camera with unchanged parameters and the distortion by effects that no parameters give; itself if none."""
    further = seen_through(camera, effects).further_distortion
    return camera if further is None else replace(camera, further_distortion=further)


def model_cube_inputs(model: Model, camera: Camera, lamp: Spectrum | None = None) -> tuple[Scene, Camera, int | None]:
    """Scene, camera and largest number of bounces of a model's spectral cube.

    lamp : spectral radiance that replaces the scene's.
    """
    settings = after_stage(model.render, model.effects, "settings")
    scene = model.scene if lamp is None else model.scene.with_lamp(lamp)
    scene = after_stage(scene, model.effects, "scene")
    return scene, after_stage(camera, model.effects, "camera"), settings.max_bounces


def labelled_cube(image: RenderedImage) -> xr.Dataset:
    """The image's cube; ``standard_error`` has the number of ``batches`` it is estimated from as an attribute."""
    cube = image.cube()
    cube["standard_error"].attrs["batches"] = len(image.coefficients)
    return cube
