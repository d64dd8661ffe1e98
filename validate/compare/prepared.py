"""A calibrated capture, ready to be compared with a render of a model's scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.colour import FilterWeights
from cboxlab.calibration.geometry import CameraFit
from cboxlab.calibration.instrument import BandResponse
from cboxlab.calibration.result import Calibration, calibrate
from cboxlab.rendering.chain import RenderSettings, after_stage
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.files import Declared
from cboxlab.rendering.model import Model, seen_through
from cboxlab.rendering.radiosity import LightField, solve_light
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture_checks import with_scene_checks
from ..predict import ExternalPicture, external_picture
from .nuisances import fit_lamp_scale, held_lamp_scale

__all__ = ["CalibratedCapture", "prepare", "solved_light", "with_model", "with_picture"]


#: Where the measured signal is so many times the model's, and this part of the picture's median, the model lacks light.
_LACKING, _LIT = 2.0, 0.05


@dataclass(frozen=True, eq=False)
class CalibratedCapture:
    """A calibrated capture that can be compared with a render, with its lamp in the model's scene.

    camera_fit, responses, weights : of the calibration, which has them all. lamp_sigma : relative standard deviation
    of the lamp's stated power, None if not stated. scene : by Lambert's law, of which changes by effects are predicted.
    complete : the same with the BSDFs and the medium of the model, which is rendered. picture : another renderer's
    picture through the calibrated camera, used instead of rendering. cache : folder of rendered pictures, or None.
    """

    calibration: Calibration
    camera_fit: CameraFit
    responses: tuple[BandResponse, ...]
    weights: FilterWeights
    scene: Scene
    lamp_sigma: float | None
    complete: Scene
    picture: ExternalPicture | None = None
    cache: Path | None = None

    @property
    def calibrated_camera(self) -> Camera:
        """The camera of the survey, with its covariance."""
        return self.camera_fit.camera

    def expected_camera(self, effects: Sequence[AppliedEffect]) -> Camera:
        """The surveyed camera moved by the effects that act on the camera (in its ten parameters), with the
        covariance of the survey.
        """
        return replace(seen_through(self.calibrated_camera, effects), further_distortion=None)

    @property
    def gathered(self) -> bool:
        """Whether the picture is gathered from patches, so that its light is known by number of reflections."""
        return self.picture is None and self.complete.diffuse

    @property
    def measured(self) -> NDArray[np.float64]:
        """(band, y, x) DN, the measured signal."""
        return self.calibration.images.signal.values

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(band, y, x) True for pixels that the capture does not mask."""
        return self.calibration.images.mask.values == 0

    def noise_reference_signal(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """(band, y, x) DN, whose noise the measured picture has: the modelled signal, or the measured one where the
        model lacks light. By a model without interreflection black surfaces would have the noise of reading alone."""
        measured = np.where(self.usable, self.measured, 0.0)
        lacking = measured > np.maximum(_LACKING * signal, _LIT * np.median(measured[self.usable]))
        return np.where(lacking, measured, signal)

    def lamp_scale(self, signal: NDArray, variance: NDArray, used: NDArray) -> tuple[float, float]:
        """As ``fit_lamp_scale``; of another renderer's picture held to what is stated, lest it hides missing light."""
        scale, sigma = fit_lamp_scale(self.measured, signal, variance, used, self.lamp_sigma)
        return (scale if self.picture is None else held_lamp_scale(scale, self.lamp_sigma)), sigma


def prepare(capture: Capture, model: Model) -> CalibratedCapture:
    """Calibrate a capture and put its lamp into the model's scene.

    Raises InputError if the capture lacks data that a comparison with a render needs.
    """
    calibration = with_scene_checks(calibrate(capture))
    manifest = capture.folder / "capture.toml"
    lamp = capture.manifest.lamp
    camera_fit, responses, weights = calibration.camera_fit, calibration.responses, calibration.weights
    lacking = [
        name
        for name, value in (
            ("[geometry] with points", camera_fit),
            ("[lamp] with radiance", lamp),
            ("data for the sensor equation (gain, lens, quantum efficiency, filters)", responses),
        )
        if value is None
    ]
    if camera_fit is None or lamp is None or responses is None or weights is None:
        raise InputError(
            manifest,
            f"no {'; no '.join(lacking)}",
            "these data, which a comparison with a render needs",
            "A calibration does not need them.",
        )
    scene = model.scene.with_lamp(capture.light(lamp.radiance))
    return CalibratedCapture(
        calibration, camera_fit, responses, weights, scene.lambertian, lamp.relative_uncertainty, scene
    )


def with_model(prepared: CalibratedCapture, model: Model) -> CalibratedCapture:
    """The same calibrated capture with another model's scene."""
    scene = model.scene.with_lamp(prepared.scene.lamp.radiance)
    return replace(prepared, scene=scene.lambertian, complete=scene, picture=None)


def solved_light(prepared: CalibratedCapture, settings: RenderSettings, effects: Sequence[AppliedEffect]) -> LightField:
    """The radiosity solution of the scene with the effects that act on scene or settings."""
    scene = after_stage(prepared.scene, effects, "scene")
    settings = after_stage(settings, effects, "settings")
    return solve_light(scene, WAVELENGTH_NM, settings.max_bounces, seed=settings.seed)


def with_picture(
    prepared: CalibratedCapture, path: Path, declared: Declared, settings: RenderSettings
) -> CalibratedCapture:
    """The capture with another renderer's cube in place of our picture.

    settings : of our own picture, by whose spectra the cube is brought to all wavelengths.
    """
    light, camera = solved_light(prepared, settings, ()), prepared.calibrated_camera
    return replace(prepared, picture=external_picture(path, prepared.scene, camera, light, declared))
