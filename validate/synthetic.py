"""A capture of a model: the forward chain with the model's effects, photographed by the simulated laboratory.

The points are surveyed, and the lamp measured, in the box as it was before any effect. What an effect of the
counts does to charge acts before shot noise, what it does to counts that are read out acts after it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM, sensor_matrix
from cboxlab.render import variant
from cboxlab.render.capture_writer import (
    band_filters,
    sphere_spectrum,
    tungsten_lamp,
    unit_responses,
    write_photographs,
)
from cboxlab.render.image import RenderedImage
from cboxlab.render.laboratory import CaptureSettings, Frame, FrameHooks
from cboxlab.render.precision import render_to_precision
from cboxlab.render.tracer import build_tracer
from cboxlab.render.warp import build_warp
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.scene_file import load_scene
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .effects import AppliedEffect, BandCurves, Counts, Light
from .expected import integral_responses, with_scene_behind
from .forward import after_stage
from .model import Model
from .sensing import CURVE_NM, FIELD_ANGLES, field_sine_squared
from .transported import transported

__all__ = [
    "SIMULATED_STAGES",
    "perturbed_camera",
    "photograph_image",
    "photographed_scene",
    "write_model_capture",
]

#: Stages whose effects a capture can contain; "settings" are the model's own shortcomings, not the box's.
SIMULATED_STAGES = ("scene", "transport", "camera", "filter", "optics", "counts")

#: Effects of the stage "counts" that act on counts as they are read out; all others act on charge.
READOUT_EFFECTS = frozenset({"nonlinearity", "dark-offset"})

# Standard deviations of a camera set up by hand: place (mm), turn (deg), and relative: focal length,
# principal point (of the width). The distortion is uniform within +-0.02.
_PLACE_MM, _TURN_DEG, _FOCAL, _PRINCIPAL, _K1 = 5.0, 0.2, 0.005, 0.005, 0.02


def perturbed_camera(size_px: int, seed: int) -> Camera:
    """The published camera as somebody has set it up: a little off in all ten parameters, by ``seed``."""
    camera = cornell_camera(size_px)
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    sigmas = np.repeat(
        [_PLACE_MM, _TURN_DEG, _FOCAL * camera.focal_length_px, _PRINCIPAL * size_px], [3, 3, 1, 2]
    )
    shift = np.append(sigmas * generator.standard_normal(9), generator.uniform(-_K1, _K1))
    return camera.with_parameters(camera.parameters + shift)


def photographed_scene(model: Model) -> Scene:
    """The model's scene without effects, under a lamp of absolute radiance.

    The published emission is relative: the published box gets a tungsten lamp. Other scenes keep their own.
    """
    scene = load_scene(model.scene)
    return scene.with_lamp(tungsten_lamp()) if model.scene == "cornell-box" else scene


@dataclass(frozen=True, eq=False)
class _ReadoutAndCharge:
    """The counts' effects as hooks of the camera."""

    bands: tuple[str, ...]
    charge: tuple[AppliedEffect, ...]
    readout: tuple[AppliedEffect, ...]
    settings: CaptureSettings

    def light(self, frame: Frame, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected light (y, x) above dark under the effects that act on charge."""
        if not self.charge:
            return signal
        dark = self._dark(frame)
        return self._applied(self.charge, frame, signal + dark) - dark

    def counts(self, frame: Frame, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Counts (y, x) under the effects that act on what is read out; of dark frames the level moves."""
        if not self.readout:
            return counts
        if frame.kind != "dark":
            return self._applied(self.readout, frame, counts)
        level = float(counts.mean())
        empty = self._frames(frame, np.full((1, 1), level), level)
        return counts + float(after_stage(empty, self.readout, "counts").dark_scene[0]) - level

    def _dark(self, frame: Frame) -> float:
        current = self.settings.dark_current_e_s / self.settings.gain_e_per_dn
        return self.settings.bias_dn + current * frame.exposure_s

    def _applied(
        self, effects: Sequence[AppliedEffect], frame: Frame, counts: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        changed = after_stage(self._frames(frame, counts, self._dark(frame)), effects, "counts")
        frames = {"band": changed.scene, "flat": changed.flat, "reference": changed.reference}
        return frames[frame.kind][self._index(frame)]

    def _index(self, frame: Frame) -> int:
        return 0 if frame.band is None else self.bands.index(frame.band)

    def _frames(self, frame: Frame, counts: NDArray[np.float64], dark: float) -> Counts:
        """One frame in the place where the effects look for it; all other frames are dark."""
        shape = len(self.bands), *counts.shape
        stacks = {kind: np.full(shape, dark) for kind in ("band", "flat", "reference")}
        if frame.kind in stacks:
            stacks[frame.kind][self._index(frame)] = counts
        level, exposure = np.full(len(self.bands), dark), np.full(len(self.bands), frame.exposure_s)
        minutes = ((frame.start_s or 0.0) + frame.exposure_s / 2) / 60.0
        return Counts(
            self.bands,
            stacks["band"],
            stacks["flat"],
            stacks["reference"],
            level,
            level,
            level,
            exposure,
            exposure,
            exposure,
            np.full(len(self.bands), minutes),
            float(self.settings.full_scale_dn),
        )


def _hooks(bands: tuple[str, ...], effects: Sequence[AppliedEffect], settings: CaptureSettings) -> FrameHooks:
    own = [effect for effect in effects if effect.effect.stage == "counts"]
    readout = tuple(effect for effect in own if effect.id in READOUT_EFFECTS)
    charge = tuple(effect for effect in own if effect.id not in READOUT_EFFECTS)
    camera = _ReadoutAndCharge(bands, charge, readout, settings)
    return FrameHooks(light=camera.light, counts=camera.counts)


def _unit_curves(settings: CaptureSettings, camera: Camera) -> BandCurves:
    """The laboratory's filters for exposures of one second, as the effects of the filter stage take them."""
    filters = band_filters()
    clear = {band: Spectrum(WAVELENGTH_NM, np.ones(WAVELENGTH_NM.size)) for band in filters}
    responses = unit_responses(settings, camera.width_px, clear)
    rest = np.zeros((len(filters), CURVE_NM.size))
    rest[:, np.isin(CURVE_NM, WAVELENGTH_NM)] = [response.response for response in responses]
    transmittance = np.array([curve.at(CURVE_NM) for curve in filters.values()])
    angles = np.linspace(0.0, 1.0, FIELD_ANGLES) * float(np.nanmax(field_sine_squared(camera)))
    return BandCurves(
        tuple(filters), CURVE_NM, np.tile(transmittance, (FIELD_ANGLES, 1, 1)), angles, rest,
        np.array([response.factor for response in responses]),
    )  # fmt: skip


def _through_filters(
    project: Callable[[NDArray[np.float64]], NDArray[np.float64]], curves: BandCurves, camera: Camera
) -> NDArray[np.float64]:
    """(band, y, x) DN/s of radiance whose ``project`` (y or 1, x or 1, q) takes weights (301, q).

    Between the field angles of the curves by a cubic spline in the sine squared.
    """
    knots = curves.sine_squared
    if np.ptp(curves.transmittance, axis=0).max() == 0:
        knots = knots[:1]
        shares: NDArray[np.float64] = np.ones((1, camera.height_px, camera.width_px))
    else:
        place = np.nan_to_num(field_sine_squared(camera), nan=knots[-1])
        shares = np.moveaxis(CubicSpline(knots, np.eye(knots.size))(place), -1, 0)
    signals = [project(sensor_matrix(integral_responses(curves, angle)).T) for angle in range(knots.size)]
    return sum(
        (share * np.moveaxis(signal, -1, 0) for share, signal in zip(shares, signals, strict=True)),
        np.zeros(()),
    )


def _effective_wavelengths(
    project: Callable[[NDArray[np.float64]], NDArray[np.float64]], curves: BandCurves
) -> NDArray[np.float64]:
    """(band,) nm, mean wavelength of the median pixel's signal on the axis."""
    weights = sensor_matrix(integral_responses(curves)).T
    level, first = project(weights), project(WAVELENGTH_NM[:, None] * weights)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nanmedian(np.where(level > 0, first / level, np.nan), axis=(0, 1))


def write_model_capture(
    folder: Path,
    model: Model,
    camera: Camera,
    settings: CaptureSettings,
    seed: int,
    relative_error: float = 1e-3,
    progress: Callable[[float], None] | None = None,
    box: Callable[[Scene], Scene] = lambda scene: scene,
) -> None:
    """Render the model with all its effects through ``camera`` and photograph it; all or nothing.

    camera : the true one when the points are surveyed. relative_error : of the render, median over pixels; it
    is not part of the noise that the capture states. box : how the real box differs from the surveyed scene.
    Repeatable by ``seed``.

    Raises InputError for effects that no capture can contain, and see ``write_photographs``.
    """
    for effect in model.effects:
        if effect.effect.stage not in SIMULATED_STAGES:
            raise InputError(
                f"effect {effect.id}", f"an effect on the model's {effect.effect.stage}",
                f"effects on {', '.join(SIMULATED_STAGES)}",
            )  # fmt: skip
    scene = photographed_scene(model)
    altered = after_stage(box(scene), model.effects, "scene")
    moved = after_stage(camera, model.effects, "camera")
    image = render_to_precision(altered, moved, WAVELENGTH_NM, relative_error, None, seed, progress)
    image = transported(image, altered, moved, model.effects, seed)
    photograph_image(folder, image, model.effects, altered, scene, camera, settings, seed)


def photograph_image(
    folder: Path,
    image: RenderedImage,
    effects: Sequence[AppliedEffect],
    seen: Scene | None,
    scene: Scene,
    camera: Camera,
    settings: CaptureSettings,
    seed: int,
) -> None:
    """Photograph an image on WAVELENGTH_NM under the effects of filters, optics and counts, in their order.

    image : with the effects of all earlier stages in it, of the scene ``seen``, None for pixels of nothing known.
    scene, camera : as surveyed, without any effect.
    Raises InputError: see ``write_photographs``.
    """
    moved = after_stage(camera, effects, "camera")
    curves = after_stage(_unit_curves(settings, moved), effects, "filter")
    sphere = sphere_spectrum().values[None, None]

    def project(weights: NDArray[np.float64]) -> NDArray[np.float64]:
        return image.project(weights)[0]

    signal = _through_filters(project, curves, moved)
    light = Light(signal, _effective_wavelengths(project, curves), moved)
    if seen is not None and variant.compiled() and any(effect.effect.stage == "optics" for effect in effects):
        warp = build_warp(build_tracer(seen), moved, image, signal)
        light = with_scene_behind(light, warp)
    signals = after_stage(light, effects, "optics").signal
    field = _through_filters(lambda weights: sphere @ weights, curves, moved)
    hooks = _hooks(curves.bands, effects, settings)
    write_photographs(folder, signals, field, image.sees_lamp, camera, scene, settings, seed, hooks)
