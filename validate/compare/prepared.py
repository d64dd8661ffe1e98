"""Calibrated capture with its lamp in a model's scene, ready for a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.colour import FilterWeights
from cboxlab.calibration.geometry import CameraFit, parameter_jacobian
from cboxlab.calibration.instrument import BandResponse
from cboxlab.calibration.quality import distance_to_surface
from cboxlab.calibration.result import Calibration, calibrate_capture
from cboxlab.rendering.chain import RenderSettings, after_stage
from cboxlab.rendering.effects import AppliedEffect, catalogue, names_in
from cboxlab.rendering.files import Declared
from cboxlab.rendering.model import Model, seen_through
from cboxlab.rendering.radiosity import LightField, solve_light
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene, Surface
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture_checks import with_scene_checks
from ..predict import ExternalPicture, external_picture
from .free_scale import FreeScale, refined_scale, rescaled, starting_scale
from .nuisances import fit_lamp_scale, held_lamp_scale

__all__ = ["CalibratedCapture", "prepare", "solved_light", "with_model", "with_picture"]

#: Ratio of the measured to the modelled signal above which the model lacks light.
_MIN_EXCESS_RATIO = 2.0

#: Largest distance from a block of a surveyed point that moves with it, mm: stated positions are rounded.
_ON_BLOCK_MM = 1.0

#: Standard deviation that points of the survey and edges of a rendering have in common, px: edges of an independent
#: simulator agree within this. The number of points does not average it.
_PICTURE_ERROR_PX = 0.005

#: Share of the picture's median signal below which a sample is too dark to say that the model lacks light.
_MIN_SIGNAL_SHARE = 0.05

#: Rounds of fits of dark levels, scale and fall-off in turn. After one, levels were off by 7 standard deviations where
#: a wall is darker than in the model that they were first fitted to; after three by less than 0.1.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class CalibratedCapture:
    """A calibrated capture that can be compared with a rendering."""

    #: Calibration with camera, responses and weights.
    calibration: Calibration
    #: Camera fitted to the surveyed points.
    camera_fit: CameraFit
    #: Response of each band.
    responses: tuple[BandResponse, ...]
    #: Filter weights from bands to X, Y, Z.
    weights: FilterWeights
    #: Scene by Lambert's law, in which changes by effects are predicted.
    scene: Scene
    #: Relative standard deviation of the lamp's stated power; None if not stated.
    lamp_sigma: float | None
    #: The same scene with BSDFs and medium, as it is rendered.
    complete: Scene
    #: Picture of an external renderer through the calibrated camera, used instead of rendering.
    picture: ExternalPicture | None = None
    #: Folder of rendered pictures and fits; None for no cache.
    cache: Path | None = None
    #: Free factors and fall-off, as far as they were estimated; None with an absolute scale and flats.
    free_scale: FreeScale | None = None

    @property
    def is_partly_unknown(self) -> bool:
        """Whether a rendering has to show what references, flats or darks would have measured."""
        return self.free_scale is not None or bool(self.calibration.bands.dark_sigma_dn.any())

    @property
    def unknown_sentences(self) -> tuple[str, ...]:
        """Sentences on references, flats and darks that a rendering replaces."""
        of_scale = () if self.free_scale is None else (self.free_scale.sentence,)
        of_darks = self.calibration.bands.dark_sentence
        return of_scale if of_darks is None else (*of_scale, of_darks)

    def fitted_to(
        self, signal: NDArray[np.float64], rendering_variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CalibratedCapture:
        """The same capture with what is unknown of it fitted to a rendering.

        Parameters
        ----------
        signal
            (band, y, x) rendered signal with the scale so far, DN.
        rendering_variance
            (band, y, x) variance of the rendering, DN^2.
        used
            (band, y, x) True for the samples used.

        Returns
        -------
        CalibratedCapture
            With scatter of its pixels, dark levels, scale and fall-off changed.
        """
        scattering = self.with_scatter_of(signal, rendering_variance, used)
        noise = scattering.calibration.predicted_variance(self.noise_reference_signal(signal))
        variance = noise + rendering_variance
        return scattering.with_levels_of(signal, variance, used)

    def fitted_about(
        self, signal: NDArray[np.float64], rendering_variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CalibratedCapture:
        """The same capture fitted to a prediction, its signals in the units of that prediction.

        Effects alter what a photograph says of dark levels and fall-off: a dark wall looks like a tilt. The responses
        of the bands stay, so that further predictions need no new factors.

        Parameters
        ----------
        signal, rendering_variance, used
            As of ``fitted_to``, of a prediction with its effects.

        Returns
        -------
        CalibratedCapture
            For a comparison with that prediction; itself with references, flats and darks.
        """
        if not self.is_partly_unknown:
            return self
        fitted = self
        for _ in range(_ROUNDS):
            before, fitted = fitted.free_scale, fitted.fitted_to(signal, rendering_variance, used)
            if before is not None and fitted.free_scale is not None:
                factors = (fitted.free_scale.constant / before.constant)[:, None, None]
                calibration = rescaled(fitted.calibration, 1 / factors[:, 0, 0], factors)
                fitted = replace(fitted, calibration=calibration, responses=self.responses)
        return fitted

    def with_scale_of(
        self, signal: NDArray[np.float64], variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CalibratedCapture:
        """The same capture with its free scale fitted to a rendering; itself with an absolute scale.

        Parameters
        ----------
        signal
            (band, y, x) rendered signal with the scale so far, DN.
        variance
            (band, y, x) variance of measured minus rendered, DN^2.
        used
            (band, y, x) True for the samples used.

        Returns
        -------
        CalibratedCapture
            With calibration and responses changed.
        """
        if self.free_scale is None:
            return self
        scale, factors, bent = refined_scale(
            self.free_scale, self.calibration, signal=signal, variance=variance, used=used
        )
        calibration = rescaled(self.calibration, factors, bent)
        responses = calibration.responses or self.responses
        return replace(self, calibration=calibration, responses=responses, free_scale=scale)

    def with_levels_of(
        self, signal: NDArray[np.float64], variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CalibratedCapture:
        """The same with dark levels and the free scale fitted to a rendering.

        Parameters
        ----------
        signal, variance, used
            As of ``with_scale_of``.

        Returns
        -------
        CalibratedCapture
            With calibration and responses changed.
        """
        bands = self.calibration.bands.with_dark_levels_of(signal, variance, used)
        levelled = replace(self, calibration=replace(self.calibration, bands=bands))
        return levelled.with_scale_of(signal, variance, used)

    def with_scatter_of(
        self, signal: NDArray[np.float64], rendering_variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CalibratedCapture:
        """The same capture with its pixels' scatter fitted; itself with flats and darks.

        Parameters
        ----------
        signal, rendering_variance, used
            As of ``fitted_to``.

        Returns
        -------
        CalibratedCapture
            With calibration changed.
        """
        calibration = self.calibration
        variance = calibration.predicted_variance(signal) + rendering_variance
        cell = calibration.capture.cell or (1, 1)
        bands = calibration.bands.with_scatter_of(signal, variance, used, cell)
        return replace(self, calibration=replace(calibration, bands=bands))

    @property
    def calibrated_camera(self) -> Camera:
        """The camera of the survey, with its covariance."""
        return self.camera_fit.camera

    def expected_camera(self, effects: Sequence[AppliedEffect]) -> Camera:
        """Surveyed camera moved by the effects that act on its ten parameters.

        Parameters
        ----------
        effects
            Effects; those of other stages do not count.

        Returns
        -------
        Camera
            With the covariance of the survey.
        """
        return replace(seen_through(self.calibrated_camera, effects), further_distortion=None)

    @property
    def gathered(self) -> bool:
        """Whether patches gather the picture, which separate light by number of reflections."""
        return self.picture is None and self.complete.diffuse

    @property
    def measured(self) -> NDArray[np.float64]:
        """(band, y, x) measured signal, DN."""
        return self.calibration.images.signal.values

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(band, y, x) True for samples that the capture does not mask."""
        return self.calibration.images.mask.values == 0

    def noise_reference_signal(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signal of the noise: the model's, or the photograph's where the model lacks light.

        In a model without interreflection, black surfaces would have the read noise alone.

        Parameters
        ----------
        signal
            (band, y, x) modelled signal, DN.

        Returns
        -------
        NDArray
            (band, y, x) signal, DN.
        """
        measured = np.where(self.usable, self.measured, 0.0)
        lacking = measured > np.maximum(
            _MIN_EXCESS_RATIO * signal, _MIN_SIGNAL_SHARE * np.median(measured[self.usable])
        )
        return np.where(lacking, measured, signal)

    def lamp_scale(self, signal: NDArray, variance: NDArray, used: NDArray) -> tuple[float, float]:
        """Fitted factor on the lamp's power and its standard deviation.

        For an external rendering the factor is bounded by the stated lamp power, so that it cannot absorb missing
        light. Without darks its error holds those of the fitted dark levels and of the references' level.

        Parameters
        ----------
        signal
            (band, y, x) rendered signal, DN.
        variance
            (band, y, x) variance of measured minus rendered, DN^2.
        used
            (band, y, x) True for the samples used.

        Returns
        -------
        float
            The factor.
        float
            Its standard deviation.
        """
        scale, sigma = fit_lamp_scale(self.measured, signal, variance, used, self.lamp_sigma)
        if (bands := self.calibration.bands).further_dark_sigma_dn.size:
            by_level = np.sum(np.where(used, signal / variance * bands.by_dark_level, 0.0), axis=(1, 2))
            of_levels = sigma**2 * by_level * bands.further_dark_sigma_dn
            sigma = float(np.sqrt(sigma**2 + of_levels @ of_levels + self.calibration.radiometry.dark_sigma**2))
        return (scale if self.picture is None else held_lamp_scale(scale, self.lamp_sigma)), sigma


def prepare(capture: Capture, model: Model) -> CalibratedCapture:
    """Calibrate a capture and put its lamp into the model's scene.

    Parameters
    ----------
    capture
        The capture.
    model
        Model with its scene.

    Returns
    -------
    CalibratedCapture
        Without an external picture and without a cache.

    Raises
    ------
    InputError
        If the capture lacks data that a comparison with a rendering needs.
    """
    calibration = with_scene_checks(calibrate_capture(_compared_with(capture, model.scene)))
    manifest = capture.folder / "capture.toml"
    lamp, manifest_is_absolute = capture.manifest.lamp, capture.manifest.is_absolute
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
            "A calibration does not need them."
            + (' Without gain and lens data state scale = "free".' if manifest_is_absolute else ""),
        )
    scene = model.scene.with_lamp(capture.light(lamp.radiance))
    return CalibratedCapture(
        calibration,
        with_tolerances(camera_fit, scene),
        responses,
        weights,
        scene.lambertian,
        lamp.relative_uncertainty if capture.manifest.is_absolute else None,
        scene,
        free_scale=starting_scale(calibration),
    )


def with_tolerances(fit: CameraFit, scene: Scene) -> CameraFit:
    """A survey's camera with tolerances of block places and picture edges in its covariance.

    All points on a block move with it, and edges of a rendering may all be off alike. The number of points does not
    average these errors.

    Parameters
    ----------
    fit
        Camera fitted to surveyed points, or by boards.
    scene
        Scene with its blocks.

    Returns
    -------
    CameraFit
        With a larger covariance.
    """
    camera = fit.camera
    if camera.covariance is None or fit.points is None:
        return fit
    position = fit.points.points_mm[fit.in_use]
    in_common = len(position) * (_PICTURE_ERROR_PX / fit.point_sigma_px) ** 2
    covariance = (1 + in_common) * np.array(camera.covariance)
    by_image = camera.covariance @ parameter_jacobian(camera, position).T / fit.point_sigma_px**2
    for block, moved in _misplaced_blocks(scene):
        on_block = distance_to_surface(block, position) < _ON_BLOCK_MM
        corners = np.c_[block.vertices_mm, np.ones(len(block.vertices_mm))]
        rigid = np.linalg.lstsq(corners, moved.vertices_mm - block.vertices_mm, rcond=None)[0]
        shift = on_block[:, None] * (np.c_[position, np.ones(len(position))] @ rigid)
        change = by_image @ (camera.project(position + shift) - camera.project(position)).ravel()
        covariance += np.outer(change, change)
    return replace(fit, camera=replace(camera, covariance=covariance))


def _misplaced_blocks(scene: Scene) -> Iterator[tuple[Surface, Surface]]:
    """Each block of a scene, and the same block off by the tolerance of a number of its place."""
    for effect in (effect for effect in catalogue().values() if effect.stage == "scene"):
        names = [p.name for p in effect.parameters if p.kind == "block"]
        for name, block in product(names, names_in(scene)["block"]):
            in_place = {name: block, **{number.name: number.null for number in effect.numbers}}
            for number in (number for number in effect.numbers if number.tolerance):
                moved = effect.apply(scene, **{**in_place, number.name: number.tolerance})
                yield from (pair for pair in zip(scene.surfaces, moved.surfaces, strict=True) if pair[0] is not pair[1])


def _compared_with(capture: Capture, scene: Scene) -> Capture:
    """A capture whose checks see a user's scene in place of the stated one."""
    reference, origin = capture.scene_reference, scene.origin
    same = origin is not None and (origin.packaged or origin.reference == reference)
    return capture if reference is None or same else replace(capture, compared_scene=scene)


def with_model(prepared: CalibratedCapture, model: Model) -> CalibratedCapture:
    """The same calibrated capture with another model's scene.

    Parameters
    ----------
    prepared
        The calibrated capture.
    model
        The other model.

    Returns
    -------
    CalibratedCapture
        With the capture's lamp in the other scene, without an external picture.
    """
    scene = model.scene.with_lamp(prepared.scene.lamp.radiance)
    return replace(prepared, scene=scene.lambertian, complete=scene, picture=None)


def solved_light(prepared: CalibratedCapture, settings: RenderSettings, effects: Sequence[AppliedEffect]) -> LightField:
    """Radiosity solution of the scene with the effects that act on scene or settings.

    Parameters
    ----------
    prepared
        The calibrated capture.
    settings
        Seed and depth of paths.
    effects
        Effects; those of other stages do not count.

    Returns
    -------
    LightField
        The solution on WAVELENGTH_NM.
    """
    scene = after_stage(prepared.scene, effects, "scene")
    settings = after_stage(settings, effects, "settings")
    return solve_light(scene, WAVELENGTH_NM, settings.max_bounces, seed=settings.seed)


def with_picture(
    prepared: CalibratedCapture, path: Path, declared: Declared, settings: RenderSettings
) -> CalibratedCapture:
    """The capture with an external renderer's cube in place of our picture.

    Parameters
    ----------
    prepared
        The calibrated capture.
    path
        File of the cube.
    declared
        Units and wavelengths that the file does not state.
    settings
        Settings of our picture, whose spectra interpolate the cube to all wavelengths.

    Returns
    -------
    CalibratedCapture
        With the picture.
    """
    light, camera = solved_light(prepared, settings, ()), prepared.calibrated_camera
    return replace(prepared, picture=external_picture(path, prepared.scene, camera, light, declared))
