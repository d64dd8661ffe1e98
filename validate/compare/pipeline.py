"""Validation of a model against a capture: rendering, fit of camera and lamp, comparison.

Drafts with more noise give the camera, through which the final picture is rendered. After the final fit, the picture is
warped to the fitted camera.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY, Mask, band_centres, band_images
from cboxlab.rendering.chain import RenderSettings, after_stage, expected_signal, render_bands, stages_between
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.files import AS_STATED, Declared
from cboxlab.rendering.image import BATCH_SEED_STEP, RenderedImage, light_shares
from cboxlab.rendering.model import Model, with_further_distortion
from cboxlab.rendering.perturbation import warp_change
from cboxlab.rendering.radiosity import LightField
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, checkpoint, share
from numpy.typing import NDArray

from ..predict import (
    CONVERGENCE,
    Picture,
    Predictor,
    build_predictor,
    cached_picture,
    render_plainly,
    render_to_noise,
    require_level,
    sensing,
    traced_picture,
)
from .comparison import Comparison, Expectation, compare
from .failure import Failure, Part, parts, ranked_failures
from .fit_cache import cached_fit
from .nuisances import NuisanceFit, Nuisances, held_lamp_scale
from .prepared import CalibratedCapture, prepare, solved_light, with_picture

__all__ = [
    "Predicted",
    "Rendered",
    "Validation",
    "compared",
    "failures",
    "refitted",
    "refitted_picture",
    "rendered_from",
    "validate_capture",
    "validate_prepared",
]

_log = logging.getLogger(__name__)

#: Noise of the drafts for the camera fit, relative to the sensor's. With less, 0.7, the final camera differs by 0.0003
#: px, as much as by a third of a change of the seed. Much more would bias the fit: moving a noisy picture smooths it.
_DRAFT_NOISE = 1.0

#: Motion of the box's corners by the fit above which another draft is rendered, px rms. The warp is exact only for
#: small motions: after a motion of 0.06 px, 0.006 px remained.
_MAX_DRAFT_MOTION_PX = 0.1

#: Reduced chi2 above which the camera fit is discarded if the camera is far from the survey, see the next constant.
_MAX_CHI2_OF_CAMERA_FIT = 100.0

#: Deviation of the fitted camera from the survey, in standard deviations, above which its fit is discarded at such a
#: chi2: the camera then compensates for missing light. Without reflected light it was turned by 10 degrees, and it
#: depended on rounding whether the cause was found.
_MAX_CAMERA_PULL_SIGMA = 10.0

#: Noise of a picture by path tracing, relative to the sensor's: a third of it takes ten times as long.
_TRACED_NOISE = 1.0

#: Power of the number of samples by which the noise of path tracing falls.
_TRACED_CONVERGENCE = 0.5

#: Samples of a pixel in the picture that first scales a capture without absolute scale, in each of its batches.
_ROUGH_SAMPLES = 8

#: Batches of that picture.
_ROUGH_BATCHES = 2

#: Relative error of that picture and of the model, for the weights of its fit.
_ROUGH_ERROR = 0.1

#: First and last share of the progress of each draft.
_DRAFTS = ((0.1, 0.2), (0.2, 0.3))


@dataclass(frozen=True, eq=False)
class Rendered:
    """Rendering of the model from the fitted camera."""

    #: The base picture, averaged over its batches.
    image: RenderedImage
    #: Fitted camera and lamp.
    fit: NuisanceFit
    #: (band, y, x) signal with the model's effects at the lamp's stated power, DN.
    signal: NDArray[np.float64]
    #: (band, y, x) variance of the Monte Carlo error, DN^2; the averaged image does not hold it.
    variance: NDArray[np.float64]
    #: (band, y, x) True for samples used.
    used: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Predicted(Rendered):
    """Rendering with a predictor of changes by effects; it needs a compiled variant."""

    #: Predictor at the fitted power of the lamp.
    predictor: Predictor
    #: Noise of the pilot, see ``render_to_noise``; None for an external rendering.
    pilot: float | None = None


@dataclass(frozen=True, eq=False)
class Validation:
    """Result of a validation."""

    #: The calibrated capture.
    prepared: CalibratedCapture
    #: The model with its effects.
    model: Model
    #: The rendering; ``Predicted`` with a compiled variant.
    rendered: Rendered
    #: Comparison of photograph and rendering.
    comparison: Comparison
    #: Wall time, s.
    seconds: float

    @property
    def light(self) -> LightField | None:
        """Radiosity solution of the picture; None without a compiled variant."""
        return self.rendered.predictor.light if isinstance(self.rendered, Predicted) else None

    @property
    def image(self) -> RenderedImage:
        """The base picture, without the effects that act after the scene."""
        return self.rendered.image

    @property
    def fit(self) -> NuisanceFit:
        """Camera and lamp fitted to the picture."""
        return self.rendered.fit


def validate_capture(
    capture: Capture,
    model: Model,
    progress: Progress = NO_PROGRESS,
    picture: Path | None = None,
    cache: Path | None = None,
    declared: Declared = AS_STATED,
) -> Validation:
    """Calibrate a capture, render a model, fit camera and lamp, compare.

    Parameters
    ----------
    capture
        The capture.
    model
        The model with its effects.
    progress
        Called with the completed share, 0 to 1.
    picture
        Spectral cube of an external renderer, used instead of our picture without effects.
    cache
        Folder of rendered pictures and fits for later runs; None for no cache.
    declared
        Units and wavelengths that the file of the picture does not state.

    Returns
    -------
    Validation
        Calibration, rendering, fit and comparison.
    """
    start = time.perf_counter()
    progress.stage("calibrating")
    prepared = replace(prepare(capture, model), cache=cache)
    if picture is not None:
        variant.require_compiled("render")
        prepared = with_picture(prepared, picture, declared, model.render)
    return replace(validate_prepared(prepared, model, progress), seconds=time.perf_counter() - start)


def validate_prepared(prepared: CalibratedCapture, model: Model, progress: Progress = NO_PROGRESS) -> Validation:
    """Render a model of a calibrated capture's scene, fit camera and lamp, compare.

    Parameters
    ----------
    prepared
        The calibrated capture, with the model's scene.
    model
        The model with its effects.
    progress
        Called with shares from 0.05 on; the calibration comes before.

    Returns
    -------
    Validation
        Its time is without the calibration.
    """
    start = time.perf_counter()
    progress.stage("rendering")
    progress.part(0.05)
    if not variant.compiled():
        _log.info("nothing can be compiled: one plain picture through the surveyed camera")
        prepared, plain = _rendered_plainly(prepared, model, share(progress, 0.05, 0.95))
        comparison = compared(prepared, plain, plain.fit.lamp_scale * plain.signal)
        return Validation(prepared, model, plain, comparison, time.perf_counter() - start)
    light = solved_light(prepared, model.render, model.effects)
    camera = prepared.expected_camera(model.effects)
    prepared, pilot = _roughly_scaled(prepared, model, light), None
    for first, last in _DRAFTS:
        before = camera
        prepared, camera, pilot = _fitted_to_draft(prepared, model, light, before, pilot, share(progress, first, last))
        motion = before.motion_px(camera, prepared.scene.corners_mm)
        _log.info("fit to a draft moves the picture by %.3g px", motion)
        if motion < _MAX_DRAFT_MOTION_PX:
            break
    final = rendered_from(prepared, light, camera, model.render, model.effects, share(progress, 0.3, 0.9), pilot)
    progress.stage("comparing")
    rendered = refitted_picture(prepared, final, model.effects, settled=motion < _MAX_DRAFT_MOTION_PX)
    checkpoint()
    surveyed = prepared.expected_camera(model.effects)
    if _camera_pull(rendered.fit, surveyed) > _MAX_CAMERA_PULL_SIGMA and _is_far_off(prepared, rendered):
        _log.info("the picture is far off, and its fit moves the camera: the surveyed camera is used")
        again = rendered_from(prepared, light, surveyed, model.render, model.effects, NO_PROGRESS, final.pilot)
        scale = held_lamp_scale(again.fit.lamp_scale, prepared.lamp_sigma)
        rendered = replace(again, fit=replace(again.fit, lamp_scale=scale), predictor=again.predictor.at_lamp(scale))
    prepared = prepared.with_scatter_of(rendered.signal, rendered.variance, rendered.used)
    comparison = compared(prepared, rendered, rendered.fit.lamp_scale * rendered.signal)
    progress.part(1.0)
    return Validation(prepared, model, rendered, comparison, time.perf_counter() - start)


def _camera_pull(fit: NuisanceFit, surveyed: Camera) -> float:
    """Distance of the fitted camera from the survey, in sigma; 0 without a covariance."""
    if surveyed.covariance is None:
        return 0.0
    deviation = fit.missed(surveyed).camera
    return float(np.sqrt(deviation @ np.linalg.solve(surveyed.covariance, deviation)))


def _is_far_off(prepared: CalibratedCapture, rendered: Rendered) -> bool:
    """Whether a fitted picture leaves a reduced chi2 at which a fit of the camera is doubtful."""
    signal, used = rendered.fit.lamp_scale * rendered.signal, rendered.used
    variance = prepared.calibration.predicted_variance(signal) + rendered.fit.lamp_scale**2 * rendered.variance
    return float(np.mean((prepared.measured - signal)[used] ** 2 / variance[used])) > _MAX_CHI2_OF_CAMERA_FIT


def _fitted_to_draft(
    prepared: CalibratedCapture,
    model: Model,
    light: LightField,
    camera: Camera,
    pilot: float | None,
    progress: Progress,
) -> tuple[CalibratedCapture, Camera, float | None]:
    """Capture and camera fitted to a draft, and the noise of the draft's pilot.

    The draft is rendered through ``camera``.
    """
    settings = replace(model.render, noise=max(_DRAFT_NOISE, model.render.noise))
    draft = rendered_from(prepared, light, camera, settings, model.effects, progress, pilot)
    if prepared.picture is not None:
        level = prepared.measured[draft.used].sum() / draft.signal[draft.used].sum()
        require_level(prepared.picture.path, float(level))
    fit = refitted(prepared, draft, model.effects, draft=True)
    if prepared.is_partly_unknown:
        signal = draft.signal + warp_change(draft.predictor.warp, fit.camera)
        prepared = prepared.fitted_to(signal, draft.variance, draft.used)
    return prepared, fit.camera, draft.pilot


def _roughly_scaled(prepared: CalibratedCapture, model: Model, light: LightField) -> CalibratedCapture:
    """The capture with its free scale, if it has one, from a picture of few samples."""
    if prepared.free_scale is None:
        return prepared
    camera = prepared.expected_camera(model.effects)
    if prepared.picture is not None:
        image = prepared.picture.through(camera, model.render.seed)
    else:
        render, _, _ = _renderer(prepared, light, camera, model.render, model.effects)
        image = render(_ROUGH_SAMPLES, 0, _ROUGH_BATCHES, NO_PROGRESS)
    return _scaled_to(prepared, render_bands(image, prepared.responses))


def _scaled_to(prepared: CalibratedCapture, bands: xr.Dataset) -> CalibratedCapture:
    """The capture with its free scale fitted to band images without regard to their noise."""
    signal = bands.signal.values
    used = prepared.usable & (bands.mask.values == 0) & (signal > 0)
    # equal relative weights, since neither the noise nor the scale is known
    level = np.array([np.mean(np.abs(prepared.measured[k][used[k]])) for k in range(len(used))])[:, None, None]
    variance = np.broadcast_to((_ROUGH_ERROR * level) ** 2, signal.shape)
    return prepared.with_scale_of(signal, variance, used)


def _rendered_plainly(
    prepared: CalibratedCapture, model: Model, progress: Progress
) -> tuple[CalibratedCapture, Rendered]:
    """The capture and its rendering without a compiled variant.

    An InputError is raised for effects that need one.
    """
    effects, camera = model.effects, prepared.expected_camera(model.effects)
    if later := [e.id for e in effects if e.stage == "transport"]:
        raise variant.not_compiled(f"model: the effect {later[0]}")
    scene = after_stage(prepared.complete, effects, "scene")
    settings = after_stage(model.render, effects, "settings")
    distorted = with_further_distortion(camera, effects)
    image = render_plainly(scene, distorted, settings.max_bounces, model.render.seed, progress)
    prepared = _scaled_to(prepared, render_bands(image, prepared.responses))
    bands = render_bands(image, prepared.responses)
    signal = expected_signal(image, sensing(prepared.calibration, camera), effects, camera)
    return prepared, _scaled(prepared, image, camera, signal, bands)


def _scaled(
    prepared: CalibratedCapture, image: RenderedImage, camera: Camera, signal: NDArray, bands: xr.Dataset
) -> Rendered:
    used = prepared.usable & (bands.mask.values == 0)
    if not (signal[used] > 0).any():
        hint = "Set max_bounces in the model file to 1 or more, or leave it out"
        raise InputError("the model's picture", "no light outside the lamp", "light to compare", hint)
    variance = prepared.calibration.predicted_variance(signal) + bands.variance.values
    scale, sigma = prepared.lamp_scale(signal, variance, used)
    return Rendered(image, NuisanceFit(camera, scale, sigma), signal, bands.variance.values, used)


def rendered_from(
    prepared: CalibratedCapture,
    light: LightField,
    camera: Camera,
    settings: RenderSettings,
    effects: Sequence[AppliedEffect],
    progress: Progress = NO_PROGRESS,
    pilot: float | None = None,
) -> Predicted:
    """Render the picture through a camera, and fit the lamp's scale.

    Its noise is that of the settings. An external picture replaces the rendering where the capture has one.

    Parameters
    ----------
    prepared
        The calibrated capture.
    light
        Radiosity solution with the same effects, see ``solved_light``.
    camera
        Camera of the picture.
    settings
        Settings without effects.
    effects
        All effects of the model.
    progress
        Called with the completed share.
    pilot
        Noise of the pilot of the same light from nearly this camera, see ``render_to_noise``.

    Returns
    -------
    Predicted
        The rendering, with the camera as given and the fitted lamp.
    """
    calibration, responses = prepared.calibration, prepared.responses
    if prepared.picture is not None:
        image, included = prepared.picture.through(camera, settings.seed), []
        bands = render_bands(image, responses)
    else:
        picture, noise, convergence = _renderer(prepared, light, camera, settings, effects)
        image, bands, pilot = render_to_noise(
            picture,
            responses,
            calibration.predicted_variance,
            prepared.usable,
            noise=noise,
            convergence=convergence,
            pilot=pilot,
            progress=progress,
        )
        included = [e for e in effects if e.stage in stages_between("scene", "settings")]
    checkpoint()
    image = image.averaged()  # the bands' variance has been taken from its batches
    checkpoint()
    predictor = build_predictor(light, image, camera, sensing(calibration, camera), prepared.scene, settings, included)
    checkpoint()
    plain = _scaled(prepared, image, camera, predictor.signal(effects), bands)
    checkpoint()
    at_lamp = predictor.at_lamp(plain.fit.lamp_scale)
    return Predicted(image, plain.fit, plain.signal, plain.variance, plain.used, at_lamp, pilot)


def _renderer(
    prepared: CalibratedCapture,
    light: LightField,
    camera: Camera,
    settings: RenderSettings,
    effects: Sequence[AppliedEffect],
) -> tuple[Picture, float, float]:
    """Renderer of our picture, its target noise, and the power by which samples lower it."""
    if prepared.gathered:

        def gathered(samples: int, first_batch: int, batches: int, report: Progress) -> RenderedImage:
            seed = settings.seed + BATCH_SEED_STEP * first_batch
            return cached_picture(prepared.cache, light, camera, samples, batches, seed, report)

        return gathered, settings.noise, CONVERGENCE
    scene = after_stage(prepared.complete, effects, "scene")
    traced = traced_picture(scene, camera, light, after_stage(settings, effects, "settings"))
    return traced, max(settings.noise, _TRACED_NOISE), _TRACED_CONVERGENCE


def refitted(
    prepared: CalibratedCapture, rendered: Predicted, effects: Sequence[AppliedEffect], **search: bool
) -> NuisanceFit:
    """Fit camera and lamp to the photograph, starting from a rendering.

    Parameters
    ----------
    prepared
        The calibrated capture.
    rendered
        The rendering.
    effects
        Effects of the prediction.
    **search
        ``settled`` and ``draft`` of ``fit_nuisances``.

    Returns
    -------
    NuisanceFit
        Fitted camera and lamp.
    """
    predictor = rendered.predictor
    signal = predictor.signal(effects)
    variance = prepared.calibration.predicted_variance(prepared.noise_reference_signal(signal)) + rendered.variance
    return cached_fit(
        prepared.cache,
        measured=prepared.measured,
        variance=variance,
        used=rendered.used,
        signal=signal,
        warp=predictor.warp,
        calibrated=prepared.expected_camera(effects),
        lamp_sigma=prepared.lamp_sigma,
        **search,
    )


def refitted_picture(
    prepared: CalibratedCapture, rendered: Predicted, effects: Sequence[AppliedEffect], settled: bool = False
) -> Predicted:
    """Refit camera and lamp, and warp the picture to the fitted camera.

    The motion is about 0.01 px, so that the picture need not be rendered again.

    Parameters
    ----------
    prepared
        The calibrated capture.
    rendered
        The rendering.
    effects
        Effects of the prediction.
    settled
        Whether the picture's camera was fitted before, see ``fit_nuisances``.

    Returns
    -------
    Predicted
        The warped rendering with its fit.
    """
    fit = refitted(prepared, rendered, effects, settled=settled)
    signal = rendered.predictor.signal(effects) + warp_change(rendered.predictor.warp, fit.camera)
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, sigma = prepared.lamp_scale(signal, variance, rendered.used)
    at_lamp = rendered.predictor.at_lamp(scale)
    return replace(rendered, fit=NuisanceFit(fit.camera, scale, sigma), signal=signal, predictor=at_lamp)


def compared(prepared: CalibratedCapture, rendered: Rendered, signal: NDArray[np.float64]) -> Comparison:
    """Compare the photograph with a modelled signal.

    Parameters
    ----------
    prepared
        The calibrated capture.
    rendered
        The rendering, for its Monte Carlo error and the surfaces that pixels see.
    signal
        (band, y, x) modelled signal with the lamp's fitted scale, DN.

    Returns
    -------
    Comparison
        The comparison.
    """
    calibration, image, responses = prepared.calibration, rendered.image, prepared.responses
    variance = rendered.variance * rendered.fit.lamp_scale**2
    mask = np.where(rendered.used | ~prepared.usable, 0, int(Mask.LAMP))
    xyz_per_dn = LUMINOUS_EFFICACY * prepared.weights.weights / np.array([r.factor for r in responses])
    lamp = prepared.scene.lamp_radiance(responses[0].wavelength_nm)
    of_sensor, compared_samples = calibration.predicted_variance(signal), prepared.usable & (mask == 0)
    return compare(
        calibration.images,
        band_images([r.band for r in responses], signal, variance, mask),
        of_sensor,
        xyz_per_dn=xyz_per_dn,
        lamp_xyz=xyz_per_dn @ [response.signal(lamp) for response in responses],
        surface=np.where(image.surface < 0, -1, image.surface),
        surface_names=image.surface_names,
        single_surface=image.single_surface,
        expectation=Expectation(
            Nuisances.count + (0 if prepared.free_scale is None else prepared.free_scale.parameters),
            calibration.bands.variance_sigma(signal, of_sensor + variance, compared_samples, calibration.noise),
        ),
        cell=calibration.capture.cell,
    )


def failures(result: Validation) -> tuple[tuple[Part, ...], tuple[Failure, ...]]:
    """Ranked list of where the model fails, with the subsets of residuals considered.

    Parameters
    ----------
    result
        The validation.

    Returns
    -------
    tuple of Part
        Subsets of the residuals.
    tuple of Failure
        The list, the densest excess first; empty if noise explains the difference.
    """
    scene, responses, c = result.prepared.scene, result.prepared.responses, result.comparison
    weights = np.stack([r.response for r in responses], axis=-1)
    centres = band_centres(responses)
    shares = None
    if isinstance(result.rendered, Predicted) and result.prepared.gathered:
        shares = light_shares(result.image, result.rendered.predictor.light.tracer.scene, weights)
    material = {surface.name: surface.material for surface in scene.surfaces}
    subsets = tuple(parts(c, material, centres, shares))
    return subsets, ranked_failures(c, subsets)
