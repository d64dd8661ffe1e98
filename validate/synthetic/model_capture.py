"""Synthetic capture of a model: forward chain with its effects, simulated laboratory.

Points and lamp are measured without any effect. Effects of the stage "counts" that act on charge are applied before
shot noise, those that act on readout after it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.chain import (
    PHOTOGRAPHED,
    Counts,
    after_stage,
    band_signals,
    field_shares,
    over_field,
    scene_light,
    uniform_light,
    with_scene_behind,
)
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_to_precision
from cboxlab.rendering.model import Model
from cboxlab.rendering.perturbation import build_warp
from cboxlab.rendering.synthetic import (
    CaptureSettings,
    Frame,
    FrameHooks,
    interleaved,
    sphere_spectrum,
    tungsten_lamp,
    unit_factors,
    write_photographs,
)
from cboxlab.rendering.visibility import build_tracer
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..predict import transported

__all__ = [
    "excess_of_render",
    "perturbed_camera",
    "photograph_image",
    "photographed_light",
    "photographed_scene",
    "write_model_capture",
]


#: Folder of a capture that holds the files of its scene.
_SCENE = "scene"

#: Standard deviation of the position of a camera set up by hand, mm.
_POSITION_SIGMA_MM = 5.0

#: Standard deviation of its rotation, degrees.
_ROTATION_SIGMA_DEG = 0.2

#: Relative standard deviation of its focal length.
_FOCAL_LENGTH_SIGMA = 0.005

#: Standard deviation of its principal point, relative to the width of the image.
_PRINCIPAL_POINT_SIGMA = 0.005

#: Largest magnitude of its radial distortion k1, drawn uniformly.
_MAX_K1 = 0.02


def perturbed_camera(size_px: int, seed: int) -> Camera:
    """The published camera with random deviations in all ten parameters.

    Parameters
    ----------
    size_px
        Width and height of the image, px.
    seed
        Repeats the deviations.

    Returns
    -------
    Camera
        Without a covariance.
    """
    camera = cornell_camera(size_px)
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    focal_px, principal_px = _FOCAL_LENGTH_SIGMA * camera.focal_length_px, _PRINCIPAL_POINT_SIGMA * size_px
    sigmas = np.repeat([_POSITION_SIGMA_MM, _ROTATION_SIGMA_DEG, focal_px, principal_px], [3, 3, 1, 2])
    shift = np.append(sigmas * generator.standard_normal(9), generator.uniform(-_MAX_K1, _MAX_K1))
    return camera.with_parameters(camera.parameters + shift)


def photographed_scene(model: Model) -> Scene:
    """The model's scene without effects, with a lamp of absolute radiance.

    The published box gets a tungsten lamp, since its published emission is relative. Other scenes keep their lamp.

    Parameters
    ----------
    model
        Model whose scene is read.

    Returns
    -------
    Scene
        As surveyed.
    """
    lamp, published = model.scene.lamp.radiance, cornell_box().lamp.radiance
    pairs = ((lamp.wavelength_nm, published.wavelength_nm), (lamp.values, published.values))
    relative = all(np.array_equal(*pair) for pair in pairs)
    return model.scene.with_lamp(tungsten_lamp()) if relative else model.scene


@dataclass(frozen=True, eq=False)
class _ReadoutAndCharge:
    """Effects of the stage "counts" as hooks of the simulated camera."""

    #: Effects that act on charge, before shot noise.
    charge: tuple[AppliedEffect, ...]
    #: Effects that act on readout, after noise.
    readout: tuple[AppliedEffect, ...]
    #: Settings of the simulated camera.
    settings: CaptureSettings

    def light(self, frame: Frame, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected signal (y, x) above dark after the effects that act on charge, DN."""
        if not self.charge:
            return signal
        dark = self._dark(frame)
        return self._applied(self.charge, frame, signal + dark) - dark

    def counts(self, frame: Frame, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Counts (y, x) after the effects on readout; in dark frames these change the level."""
        if not self.readout:
            return counts
        if frame.kind != "dark":
            return self._applied(self.readout, frame, counts)
        level = float(counts.mean())
        empty = self._frames(frame, np.full((1, 1), level), level)
        return counts + float(after_stage(empty, self.readout, "counts").dark_scene[0]) - level

    def _dark(self, frame: Frame) -> float:
        """Dark level of a frame, DN."""
        current = self.settings.dark_current_e_s / self.settings.gain_e_per_dn
        return self.settings.bias_dn + current * frame.exposure_s

    def _applied(
        self, effects: Sequence[AppliedEffect], frame: Frame, counts: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(y, x) counts of a frame after effects."""
        changed = after_stage(self._frames(frame, counts, self._dark(frame)), effects, "counts")
        frames = {"band": changed.scene, "flat": changed.flat, "reference": changed.reference}
        indices = self._bands_of(frame)
        bands = [self.settings.bands[index] for index in indices]
        return interleaved(frames[frame.kind][indices], bands, self.settings.mosaic)

    def _bands_of(self, frame: Frame) -> list[int]:
        """Indices of the bands that see a frame."""
        return [index for index, band in enumerate(self.settings.bands) if band.filter == frame.filter]

    def _frames(self, frame: Frame, counts: NDArray[np.float64], dark: float) -> Counts:
        """Counts with this frame at its kind and band, and dark level everywhere else."""
        bands = self.settings.band_ids
        shape = len(bands), *counts.shape
        stacks = {kind: np.full(shape, dark) for kind in ("band", "flat", "reference")}
        if frame.kind in stacks:
            stacks[frame.kind][self._bands_of(frame)] = counts
        level, exposure = np.full(len(bands), dark), np.full(len(bands), frame.exposure_s)
        minutes = ((frame.start_s or 0.0) + frame.exposure_s / 2) / 60.0
        return Counts(
            bands,
            stacks["band"],
            stacks["flat"],
            stacks["reference"],
            level,
            level,
            level,
            exposure,
            exposure,
            exposure,
            np.full(len(bands), minutes),
            float(self.settings.full_scale_dn),
        )


def _hooks(effects: Sequence[AppliedEffect], settings: CaptureSettings) -> FrameHooks:
    """Hooks of the simulated camera by the effects of the stage "counts"."""
    count_effects = [effect for effect in effects if effect.stage == "counts"]
    readout = tuple(effect for effect in count_effects if not effect.effect.acts_on_charge)
    charge = tuple(effect for effect in count_effects if effect.effect.acts_on_charge)
    camera = _ReadoutAndCharge(charge, readout, settings)
    return FrameHooks(light=camera.light, counts=camera.counts)


def write_model_capture(
    folder: Path,
    model: Model,
    camera: Camera,
    settings: CaptureSettings,
    seed: int,
    *,
    relative_error: float = 1e-3,
    progress: Progress = NO_PROGRESS,
    box: Callable[[Scene], Scene] = lambda scene: scene,
) -> float:
    """Render the model with all its effects and write the simulated capture.

    An incomplete folder is removed.

    Parameters
    ----------
    folder
        Folder to create.
    model
        Model with its effects.
    camera
        The true camera at the survey of the points.
    settings
        Settings of the simulated laboratory.
    seed
        Repeats render and noise.
    relative_error
        Relative standard error of the rendering, median over pixels; not part of the noise that the capture states.
    progress
        Reports the completed share.
    box
        Change of the real box relative to the surveyed scene.

    Returns
    -------
    float
        Chi2 per sample that the render's error adds, see `excess_of_render`.

    Raises
    ------
    InputError
        For effects that a capture cannot contain, and like `write_photographs`.
    """
    for effect in model.effects:
        if effect.stage not in PHOTOGRAPHED:
            raise InputError(
                f"effect {effect.id}",
                f"an effect on the model's {effect.stage}",
                f"effects on {', '.join(PHOTOGRAPHED)}",
            )
    scene = photographed_scene(model)
    altered = after_stage(box(scene), model.effects, "scene")
    moved = after_stage(camera, model.effects, "camera")
    image = render_to_precision(RenderJob(altered, moved, WAVELENGTH_NM, seed=seed), relative_error, progress=progress)
    progress.stage("photographing")
    image = transported(image, altered, moved, model.effects, seed)
    files = () if model.scene.origin is None else model.scene.origin.files
    if files:
        settings = replace(settings, scene=f"{_SCENE}/{files[0].name}")
    photograph_image(folder, image, model.effects, altered, scene, camera, settings=settings, seed=seed)
    for file in files:
        copy = folder / _SCENE / file.relative_to(files[0].parent)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    return excess_of_render(image, settings)


def excess_of_render(image: RenderedImage, settings: CaptureSettings) -> float:
    """Largest excess of chi2 per sample by the render's error.

    The variance of the render over that of the frames' mean. The error is the same in every frame, so that no repeat
    shows it. Noise of flats and darks lowers the excess.

    Parameters
    ----------
    image
        Render on WAVELENGTH_NM, with several batches.
    settings
        Settings of the camera: shot and read noise at the planned exposures.

    Returns
    -------
    float
        Mean over samples brighter than read noise and outside the lamp.
    """
    factors = unit_factors(settings, image.sees_lamp.shape[1])
    weights = (factors.transmittance * factors.rest).T
    mean, variance = (part[~image.sees_lamp] for part in image.project(weights))
    full = settings.level * settings.full_scale_dn * settings.gain_e_per_dn
    electrons = full * mean / np.percentile(mean, 99.5, axis=0)
    exposed = electrons > settings.read_noise_e
    noise = (electrons + settings.read_noise_e**2) / settings.repeats
    return float(np.mean(variance[exposed] / mean[exposed] ** 2 * electrons[exposed] ** 2 / noise[exposed]))


def photograph_image(
    folder: Path,
    image: RenderedImage,
    effects: Sequence[AppliedEffect],
    image_scene: Scene | None,
    scene: Scene,
    camera: Camera,
    *,
    settings: CaptureSettings,
    seed: int,
) -> None:
    """Write the simulated capture of an image, with the effects on filters, optics and counts.

    Parameters
    ----------
    folder
        Folder to create.
    image
        Image on WAVELENGTH_NM, with the effects of all earlier stages.
    effects
        All effects of the model.
    image_scene
        Scene of the image; None if not known: then blurs do not count what lies behind its edges.
    scene
        Scene as surveyed, without any effect.
    camera
        Camera as surveyed, without any effect.
    settings
        Settings of the simulated laboratory.
    seed
        Repeats the noise.

    Raises
    ------
    InputError
        Like `write_photographs`.
    """
    signals, field, hooks = photographed_light(image, effects, image_scene, camera, settings)
    write_photographs(
        folder,
        signals,
        field,
        image.sees_lamp,
        camera=camera,
        scene=scene,
        settings=settings,
        seed=seed,
        hooks=hooks,
    )


def photographed_light(
    image: RenderedImage,
    effects: Sequence[AppliedEffect],
    image_scene: Scene | None,
    camera: Camera,
    settings: CaptureSettings,
) -> tuple[NDArray[np.float64], NDArray[np.float64], FrameHooks]:
    """Signals and hooks with which `write_photographs` simulates a capture.

    The signals are computed as in the prediction (``rendering.chain``). The camera is simulated frame by frame instead:
    with its time, shot noise, and effects before or after it.

    Parameters
    ----------
    image
        Image on WAVELENGTH_NM, with the effects of all earlier stages.
    effects
        All effects of the model.
    image_scene
        Scene of the image; None if not known.
    camera
        Camera as surveyed, without any effect.
    settings
        Settings of the simulated laboratory.

    Returns
    -------
    signals : NDArray
        (band, y, x) signal of the scene, DN/s.
    field : NDArray
        (band, y, x) signal of the integrating sphere, DN/s.
    hooks : FrameHooks
        Effects on counts.
    """
    moved = after_stage(camera, effects, "camera")
    factors = unit_factors(settings, camera.width_px, grid=FILTER_GRID)
    curves = after_stage(over_field(factors, moved), effects, "filter")
    light = scene_light(image, curves, moved)
    if image_scene is not None and variant.compiled() and any(effect.stage == "optics" for effect in effects):
        light = with_scene_behind(light, build_warp(build_tracer(image_scene), moved, image, light.signal))
    signals = after_stage(light, effects, "optics").signal
    even = uniform_light(sphere_spectrum(settings.sphere_brightness).values)
    sphere = band_signals(even, curves, field_shares(curves, moved))
    return signals, np.broadcast_to(sphere, signals.shape), _hooks(effects, settings)
