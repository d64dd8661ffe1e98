"""The main job: a capture and a model go in; a comparison and its report come out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.band_images import Mask, band_images
from cboxlab.calibration.calibrate import Calibration, calibrate
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.colorimetry import LUMINOUS_EFFICACY
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM
from cboxlab.render import variant
from cboxlab.render.bands import render_bands
from cboxlab.render.final_gather import LightField, solve_light
from cboxlab.render.image import RenderedImage
from cboxlab.render.light_shares import light_shares
from cboxlab.render.warp import warp_change
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.scene_file import load_scene
from numpy.typing import NDArray

from .blocks import ReportSection
from .compare import Comparison, compare
from .effects import AppliedEffect
from .expected import expected_signal
from .failure import Failure, Part, failure_section, parts, ranked_failures
from .foreign import ForeignPicture, foreign_picture, require_level
from .forward import after_stage
from .maps import write_maps
from .metrics import PathStep, Run, write_metrics
from .model import Model, RenderSettings
from .nuisances import NuisanceFit, fit_lamp_scale, fit_nuisances
from .picture_cache import cached_picture, content_key
from .plain_rendering import render_plainly
from .predictor import Predictor, build_predictor
from .rendering import Progress, render_to_noise
from .report import ReportInputs, build_report
from .sensing import sensing

__all__ = [
    "Prepared", "Rendered", "Validation", "compared", "failures", "polished", "prepare", "refitted", "rendered_from",
    "solved_light", "validate", "write_validation",
]  # fmt: skip

#: The camera is refitted on renders with this part of the sensor's noise (more would pull at it, since moving a
#: noisy picture smooths it); each starts where the last ended: moving edges is exact only over short ways.
_DRAFT_NOISE = 0.7
_DRAFTS = 2


@dataclass(frozen=True, eq=False)
class Prepared:
    """A capture made ready: calibrated, with its own lamp in the model's scene.

    lamp_sigma : relative standard deviation of the lamp's stated power, None where nothing is stated.
    picture : another renderer's, through the calibrated camera, in place of ours. cache : where rendered pictures are
    kept, None for nowhere.
    """

    calibration: Calibration
    scene: Scene
    calibrated_camera: Camera
    lamp_sigma: float | None
    picture: ForeignPicture | None = None
    cache: Path | None = None

    def expected_camera(self, effects: Sequence[AppliedEffect]) -> Camera:
        """Where the survey, and effects that have moved the camera since, say that it is; covariance of the survey."""
        return after_stage(self.calibrated_camera, effects, "camera")

    @property
    def measured(self) -> NDArray[np.float64]:
        """(band, y, x) DN."""
        return self.calibration.images.signal.values

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(band, y, x) pixels that nothing in the capture masks."""
        return self.calibration.images.mask.values == 0


@dataclass(frozen=True, eq=False)
class Rendered:
    """The model's picture from the fitted camera. variance : (band, y, x) DN^2 of its Monte Carlo error.

    signal : (band, y, x) DN with the model's effects, at the lamp's stated power. used : pixels that count.
    predictor : None where nothing can be compiled.
    """

    image: RenderedImage
    predictor: Predictor | None
    fit: NuisanceFit
    signal: NDArray[np.float64]
    variance: NDArray[np.float64]
    used: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Validation:
    """What ``validate`` found, ready to be written."""

    prepared: Prepared
    model: Model
    light: LightField | None
    rendered: Rendered
    comparison: Comparison
    seconds: float

    @property
    def image(self) -> RenderedImage:
        """The base picture, without the effects that act after the scene."""
        return self.rendered.image

    @property
    def fit(self) -> NuisanceFit:
        """Camera and lamp as fitted to the picture."""
        return self.rendered.fit


def prepare(folder: Path, model: Model) -> Prepared:
    """Load and calibrate a capture and put its lamp into the model's scene.

    Raises InputError where the capture lacks what a comparison with a render takes.
    """
    capture = load_capture(folder)
    calibration = calibrate(capture)
    manifest = folder / "capture.toml"
    lamp = capture.manifest.lamp
    lacking = [
        name
        for name, value in (
            ("[geometry] with points", calibration.camera_fit),
            ("[lamp] with radiance", lamp),
            (
                "what the sensor equation takes (gain, lens, quantum efficiency, filters)",
                calibration.responses,
            ),
        )
        if value is None
    ]
    if lacking or calibration.camera_fit is None or lamp is None:
        raise InputError(
            manifest,
            f"no {'; no '.join(lacking)}",
            "a capture that can be rendered",
            "`cbox calibrate` does what it allows",
        )
    scene = load_scene(model.scene).with_lamp(capture.light(lamp.radiance))
    return Prepared(calibration, scene, calibration.camera_fit.camera, lamp.relative_uncertainty)


def solved_light(
    prepared: Prepared, settings: RenderSettings, effects: Sequence[AppliedEffect]
) -> LightField:
    """The light in the scene under those of the effects that act on scene or settings."""
    scene = after_stage(prepared.scene, effects, "scene")
    settings = after_stage(settings, effects, "settings")
    return solve_light(scene, WAVELENGTH_NM, settings.max_bounces, seed=settings.seed)


def validate(
    folder: Path, model: Model, progress: Progress | None = None, picture: Path | None = None,
    cache: Path | None = None,
) -> Validation:  # fmt: skip
    """Calibrate, render, fit the nuisances, compare. ``progress`` is told the part done, 0 to 1.

    picture : a spectral cube of another renderer in place of our picture without effects. cache : where rendered
    pictures are kept from run to run.
    """
    start = time.perf_counter()
    report = progress or (lambda part: None)
    prepared = replace(prepare(folder, model), cache=cache)
    if picture is not None:
        if not variant.compiled():
            raise InputError("--render", "no compiled variant", "LLVM 16 or newer, or a GPU", variant.HINT)
        light = solved_light(prepared, model.render, ())
        image = foreign_picture(picture, prepared.scene, prepared.calibrated_camera)
        prepared = replace(prepared, picture=ForeignPicture(image, prepared.calibrated_camera, light))
    report(0.05)
    if not variant.compiled():
        rendered = _rendered_plainly(prepared, model, report)
        comparison = compared(prepared, rendered, rendered.fit.lamp_scale * rendered.signal)
        return Validation(prepared, model, None, rendered, comparison, time.perf_counter() - start)
    light = solved_light(prepared, model.render, model.effects)
    camera = prepared.expected_camera(model.effects)
    for draft in range(_DRAFTS):
        settings = replace(model.render, noise=_DRAFT_NOISE)
        rendered = rendered_from(prepared, light, camera, settings, model.effects)
        if picture is not None:
            require_level(picture, rendered.fit.lamp_scale)
        camera = refitted(prepared, rendered, model.effects).camera
        report(0.1 + 0.1 * (draft + 1))
    last = rendered_from(
        prepared, light, camera, model.render, model.effects, lambda part: report(0.3 + 0.6 * part)
    )
    rendered = polished(prepared, last, model.effects)
    comparison = compared(prepared, rendered, rendered.fit.lamp_scale * rendered.signal)
    report(1.0)
    return Validation(prepared, model, light, rendered, comparison, time.perf_counter() - start)


def _rendered_plainly(prepared: Prepared, model: Model, progress: Progress) -> Rendered:
    calibration, effects = prepared.calibration, model.effects
    camera = prepared.expected_camera(effects)
    if later := [e.id for e in effects if e.effect.stage == "transport"]:
        expected = "effects that need no compiled variant"
        raise InputError("model", f"the effect {later[0]}", expected, variant.HINT)
    scene = after_stage(prepared.scene, effects, "scene")
    settings = after_stage(model.render, effects, "settings")
    image = render_plainly(scene, camera, settings.max_bounces, model.render.seed, progress)
    assert calibration.responses is not None
    bands = render_bands(image, calibration.responses)
    signal = expected_signal(image, sensing(calibration, camera), effects, camera)
    return _scaled(prepared, image, None, camera, signal, bands)


def _scaled(
    prepared: Prepared, image: RenderedImage, predictor: Predictor | None, camera: Camera, signal: NDArray,
    bands: xr.Dataset,
) -> Rendered:  # fmt: skip
    used = prepared.usable & (bands.mask.values == 0)
    if not (signal[used] > 0).any():
        hint = "In the model file let max_bounces be 1 or more, or leave it out"
        raise InputError("the model's picture", "no light outside the lamp", "light to compare", hint)
    variance = prepared.calibration.predicted_variance(signal) + bands.variance.values
    scale, sigma = fit_lamp_scale(prepared.measured, signal, variance, used, prepared.lamp_sigma)
    return Rendered(image, predictor, NuisanceFit(camera, scale, sigma), signal, bands.variance.values, used)


def rendered_from(
    prepared: Prepared, light: LightField, camera: Camera, settings: RenderSettings, effects: Sequence[AppliedEffect],
    progress: Progress | None = None,
) -> Rendered:  # fmt: skip
    """Gather the picture through ``camera`` down to the noise asked for; fit the lamp's scale.

    A picture kept from before comes through the camera that it was made with.
    light : solved under the same effects (see ``solved_light``).
    """
    calibration = prepared.calibration
    responses = calibration.responses
    assert responses is not None
    if prepared.picture is not None:
        image, included = prepared.picture.through(camera, settings.seed), []
    else:

        def make() -> RenderedImage:
            return render_to_noise(
                light, camera, responses, calibration.predicted_variance, prepared.usable, settings.noise,
                settings.seed, progress,
            )[0]  # fmt: skip

        scene = light.tracer.scene
        dark = calibration.predicted_variance(np.zeros_like(prepared.measured))
        factors = [(r.band, r.factor, r.response.tolist()) for r in responses]
        key = content_key(
            scene, light.max_bounces, settings.noise, settings.seed, prepared.usable, dark, factors
        )
        image, camera = cached_picture(prepared.cache, key, camera, _corners(scene), make)
        included = [e for e in effects if e.effect.stage in ("scene", "settings")]
    bands = render_bands(image, responses)
    predictor = build_predictor(
        light, image, camera, sensing(calibration, camera), prepared.scene, settings, included
    )
    return _scaled(prepared, image, predictor, camera, predictor.signal(effects), bands)


def refitted(prepared: Prepared, rendered: Rendered, effects: Sequence[AppliedEffect]) -> NuisanceFit:
    """Camera and lamp fitted to the measured picture, starting from a rendered one under these effects."""
    predictor = rendered.predictor
    assert predictor is not None
    signal = predictor.signal(effects)
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    return fit_nuisances(
        prepared.measured, variance, rendered.used, signal, predictor.warp, prepared.expected_camera(effects),
        prepared.lamp_sigma,
    )  # fmt: skip


def polished(prepared: Prepared, rendered: Rendered, effects: Sequence[AppliedEffect]) -> Rendered:
    """The last hundredth of a pixel: camera and lamp refitted, and the picture warped instead of rendered again."""
    fit = refitted(prepared, rendered, effects)
    assert rendered.predictor is not None
    signal = rendered.signal + warp_change(rendered.predictor.warp, fit.camera)
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, sigma = fit_lamp_scale(prepared.measured, signal, variance, rendered.used, prepared.lamp_sigma)
    return replace(rendered, fit=NuisanceFit(fit.camera, scale, sigma), signal=signal)


def compared(prepared: Prepared, rendered: Rendered, signal: NDArray[np.float64]) -> Comparison:
    """The comparison of the measured picture with a modelled ``signal`` (band, y, x) DN, lamp scale included."""
    calibration, image = prepared.calibration, rendered.image
    responses, weights = calibration.responses, calibration.weights
    assert responses is not None and weights is not None
    variance = rendered.variance * rendered.fit.lamp_scale**2
    mask = np.where(rendered.used | ~prepared.usable, 0, int(Mask.LAMP))
    xyz_per_dn = LUMINOUS_EFFICACY * weights.weights / np.array([r.factor for r in responses])
    lamp = prepared.scene.lamp.radiance.at(responses[0].wavelength_nm)
    return compare(
        calibration.images,
        band_images([r.band for r in responses], signal, variance, mask),
        calibration.predicted_variance(signal),
        xyz_per_dn=xyz_per_dn,
        lamp_xyz=xyz_per_dn @ [response.signal(lamp) for response in responses],
        surface=np.where(image.surface < 0, -1, image.surface),
        surface_names=image.surface_names,
        pure=image.pure,
        fitted_parameters=11,
    )


def failures(result: Validation) -> tuple[tuple[Part, ...], tuple[Failure, ...]]:
    """What the residuals are told apart by, and the ranked list of where the model fails."""
    scene, c = result.prepared.scene, result.comparison
    responses = result.prepared.calibration.responses or ()
    weights = np.stack([r.response for r in responses], axis=-1)
    centres = (responses[0].wavelength_nm @ weights) / weights.sum(axis=0)
    split = result.light is not None and result.prepared.picture is None
    shares = light_shares(result.image, len(scene.materials), weights) if split else None
    material = {surface.name: surface.material for surface in scene.surfaces}
    known = tuple(parts(c, material, centres, shares))
    return known, ranked_failures(c, known)


def _assumptions(result: Validation) -> list[str]:
    prepared, fit = result.prepared, result.fit
    sigma = prepared.lamp_sigma
    lamp = (
        f"within its stated {100 * sigma:.2g} % (one standard deviation)"
        if sigma
        else "freely: no uncertainty is stated"
    )
    expected = prepared.expected_camera(result.model.effects)
    moved = fit.camera.project(_corners(prepared.scene)) - expected.project(_corners(prepared.scene))
    bounces = result.model.render.max_bounces
    light = (
        "All interreflection is followed"
        if bounces is None
        else f"Light is followed over {bounces} reflections only"
    )
    effects = ", ".join(effect.id for effect in result.model.effects) or "none"
    return [
        f"Scene: {prepared.scene.name}. Paints are Lambertian, the lamp emits uniformly by Lambert's law and reflects "
        "nothing, the air is clear, the front is open and dark, unless an effect below says otherwise.",
        f"Effects in the model: {effects}.",
        f"The lamp's spectrum is the capture's own; its power was fitted {lamp}.",
        "The camera was fitted to the surveyed points and then refitted to the picture within the survey's covariance; "
        f"the box's corners moved by {np.sqrt(np.nanmean(moved**2)):.2f} px (rms per coordinate).",
        f"{light}. The render's standard error is counted in every figure.",
        "Measured and rendered XYZ go through the same filter weights, so colour differences speak of the model; "
        "the weights' own error against the CIE functions is shown apart.",
    ]


def _corners(scene: Scene) -> NDArray[np.float64]:
    return np.concatenate([surface.vertices_mm for surface in scene.surfaces])


def write_validation(
    result: Validation, folder: Path, sections: Sequence[ReportSection] = (), path: Sequence[PathStep] = ()
) -> None:
    """Write report.html, metrics.json and the maps into ``folder``; a diagnosis adds its sections and path."""
    prepared, fit = result.prepared, result.fit
    camera_fit = prepared.calibration.camera_fit
    assert camera_fit is not None
    known, failed = failures(result)
    run = Run(
        capture=prepared.calibration.capture.manifest.name or prepared.calibration.capture.folder.name,
        model=result.model.name,
        version=version("cboxlab"),
        seconds=result.seconds,
        camera=fit.camera,
        calibrated_camera=prepared.calibrated_camera,
        reprojection_rms_px=camera_fit.reprojection_rms_px,
        lamp_scale=fit.lamp_scale,
        lamp_scale_sigma=fit.lamp_scale_sigma,
        lamp_scale_prior_sigma=prepared.lamp_sigma if prepared.lamp_sigma is not None else float("nan"),
        path=path,
        failures=failed,
    )
    write_maps(folder / "maps", result.comparison)
    write_metrics(folder / "metrics.json", result.comparison, run)
    build_report(
        folder / "report.html",
        ReportInputs(
            result.comparison, run, _assumptions(result),
            weights=prepared.calibration.weights, responses=prepared.calibration.responses or (),
            sections=(failure_section(result.comparison, known, failed), *sections),
            further_warnings=prepared.calibration.notes,
        ),
    )  # fmt: skip
