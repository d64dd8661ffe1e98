"""Scene, settings and camera of a model after its effects."""

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
    """Change of a camera's parameters by effects.

    Parameters
    ----------
    camera
        Camera without effects.
    before
        Effects that act first.
    effects
        Effects that act after them.

    Returns
    -------
    NDArray
        (10,) change in the order and units of ``PARAMETER_NAMES``.
    """
    both = seen_through(camera, (*before, *effects)), seen_through(camera, before)
    return np.asarray(both[0].parameters - both[1].parameters)


def seen_through(camera: Camera, effects: Sequence[AppliedEffect]) -> Camera:
    """Camera after effects, with the ten parameters closest to it.

    Parameters
    ----------
    camera
        Camera without effects.
    effects
        The model's effects; those of other stages are ignored.

    Returns
    -------
    Camera
        The camera. Its further distortion is the smallest that the parameters leave.
    """
    return after_stage(camera, effects, "camera").closest_parameters()


def with_further_distortion(camera: Camera, effects: Sequence[AppliedEffect]) -> Camera:
    """Camera with unchanged parameters, and the distortion by effects that no parameters give.

    Parameters
    ----------
    camera
        A camera whose parameters were fitted, so that they include the effects.
    effects
        The model's effects.

    Returns
    -------
    Camera
        The camera; itself if the effects cause no further distortion.
    """
    further = seen_through(camera, effects).further_distortion
    return camera if further is None else replace(camera, further_distortion=further)


def model_cube_inputs(model: Model, camera: Camera, lamp: Spectrum | None = None) -> tuple[Scene, Camera, int | None]:
    """Scene, camera and number of bounces of a model's spectral cube.

    Parameters
    ----------
    model
        The model, with its effects.
    camera
        Camera without effects.
    lamp
        Spectral radiance of the first lamp, W m^-2 sr^-1 nm^-1; None for that of the scene.

    Returns
    -------
    scene : Scene
        Scene after the effects of the scene stage.
    camera : Camera
        Camera after the effects of the camera stage.
    max_bounces : int or None
        Largest number of reflections; None without limit.
    """
    settings = after_stage(model.render, model.effects, "settings")
    scene = model.scene if lamp is None else model.scene.with_lamp(lamp)
    scene = after_stage(scene, model.effects, "scene")
    return scene, after_stage(camera, model.effects, "camera"), settings.max_bounces


def labelled_cube(image: RenderedImage) -> xr.Dataset:
    """Spectral cube of a rendered image.

    Parameters
    ----------
    image
        The rendered image.

    Returns
    -------
    xr.Dataset
        The cube. The variable ``standard_error`` has the attribute ``batches``, the number of independent batches that
        it was estimated from.
    """
    cube = image.cube()
    cube["standard_error"].attrs["batches"] = len(image.coefficients)
    return cube
