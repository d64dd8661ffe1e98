"""The complete calibration of a capture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

from ..capture import (
    Capture,
    band_channels,
    brighter_channel_notes,
    chosen_channel_notes,
    file_mosaic_notes,
)
from ..colour import (
    ChainCheck,
    ColourStudy,
    FilterWeights,
    PatchTable,
    chart_sensitivities,
    check_chain,
    measure_patches,
    study_colour,
    xyz_image,
)
from ..correction import (
    CorrectedBands,
    DarkLibrary,
    LensAxis,
    NoiseModel,
    correct_bands,
    measure_merged_noise,
    measure_noise,
    read_darks,
    with_full_well,
)
from ..detector import NO_STUDY, Linearity, SensorStudy, measure_linearity, study_sensor
from ..geometry import CameraFit, TargetFit, calibrate_camera
from ..instrument import BandResponse, Mask, interpolated_channel
from ..quality import Suspicion, explain_points, find_suspicions
from ..radiometry import (
    Radiometry,
    Uncertainty,
    band_responses,
    channel_levels,
    level_notes,
    measure_constant,
    measure_uncertainty,
    missing_keys,
)

__all__ = ["Calibration", "calibrate_capture"]


@dataclass(frozen=True, eq=False)
class Calibration(FrozenMappings):
    """Calibration of a capture. A part is None if the capture lacks the data."""

    #: Capture that was calibrated, its full well applied.
    capture: Capture
    #: Darks by exposure.
    dark: DarkLibrary
    #: Noise model of one frame.
    noise: NoiseModel
    #: By band, the channel of a sensor with a mosaic; None without a mosaic.
    channels: Mapping[str, str] | None
    #: Corrected bands with variance and mask.
    bands: CorrectedBands
    #: Constant C of the sensor equation.
    radiometry: Radiometry
    #: One response per band, with its factor K_i.
    responses: tuple[BandResponse, ...] | None
    #: Filter weights by three methods with their errors.
    colour: ColourStudy | None
    #: Camera fitted to the surveyed points.
    camera_fit: CameraFit | None
    #: Intrinsics from flat targets, fitted jointly with the survey if there is one.
    target_fit: TargetFit | None
    #: Linearity, black level and exposure offset from the brackets.
    linearity: Linearity | None
    #: Photon transfer, dark level, response and calibration curve.
    sensor: SensorStudy
    #: Band and common components of the uncertainty.
    uncertainty: Uncertainty
    #: Reflectances of the labelled patches.
    patches: PatchTable | None
    #: Missing data, data not used and other remarks, one sentence each.
    notes: tuple[str, ...]
    #: Likely mistakes of the capture, apart from `notes`.
    suspicions: tuple[Suspicion, ...] = ()
    #: The colour chain held against the patches.
    chain: ChainCheck | None = None

    @property
    def camera(self) -> Camera | None:
        """Camera with covariance: from the joint fit with flat targets, or the survey; or None."""
        if self.target_fit is not None and self.target_fit.survey_camera is not None:
            return self.target_fit.survey_camera
        return None if self.camera_fit is None else self.camera_fit.camera

    @property
    def images(self) -> xr.Dataset:
        """The measured BandImages (band, y, x), bands in the manifest's order."""
        return self.bands.images

    @property
    def photograph(self) -> NDArray[np.float64]:
        """(y, x) mean of the bands over their 99th percentiles, for display and edge detection.

        Behind a mosaic the gaps of every channel are interpolated.
        """
        signal, cell = self.images["signal"].values, self.capture.cell
        if cell is not None:
            in_channel = (self.images["mask"].values & Mask.OTHER_CHANNEL) == 0
            signal = np.stack([interpolated_channel(*band, cell) for band in zip(signal, in_channel, strict=True)])
        return np.asarray(np.mean(signal / np.percentile(signal, 99, axis=(1, 2), keepdims=True), axis=0), np.float64)

    def predicted_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Variance of the corrected signals, given their expectation.

        Parameters
        ----------
        expected_signal
            (band, y, x) expected signals, DN.

        Returns
        -------
        NDArray
            (band, y, x) variance, DN^2.
        """
        return self.bands.predicted_variance(expected_signal)

    @property
    def weights(self) -> FilterWeights | None:
        """Filter weights in use: those of the three methods with the smallest colour error."""
        return None if self.colour is None else self.colour.weights[self.colour.recommended]

    def xyz(self) -> xr.Dataset:
        """Measured tristimulus images, see ``xyz_image``.

        Returns
        -------
        xr.Dataset
            X, Y, Z with variance, covariances and mask.

        Raises
        ------
        ValueError
            If the capture lacks the data.
        """
        if self.weights is None or self.responses is None:
            raise ValueError("the capture lacks the data for XYZ: see notes")
        relative = None if self.colour is None else self.colour.errors[self.colour.recommended].relative
        cell = self.capture.cell
        return xyz_image(self.images, self.weights, self.responses, self.uncertainty, relative, cell)


def _typical_noise(images: xr.Dataset) -> NDArray[np.float64]:
    """(band,) median relative standard deviation over the unmasked, lit pixels of each band."""
    noise = []
    for band in range(images.sizes["band"]):
        signal, variance = images["signal"].values[band], images["variance"].values[band]
        bright = (images["mask"].values[band] == 0) & (signal > 3 * np.sqrt(variance))
        noise.append(float(np.median(np.sqrt(variance[bright]) / signal[bright])) if np.any(bright) else 1.0)
    return np.array(noise)


def _camera(
    capture: Capture,
) -> tuple[CameraFit | None, TargetFit | None, list[str], tuple[Suspicion, ...]]:
    """``calibrate_camera``, but no camera where a known mistake explains the points."""
    try:
        return *calibrate_camera(capture), ()
    except InputError as fault:
        explained = explain_points(capture, fault)
        if explained is None:
            raise
        return None, None, [f"no camera: {explained.what}"], (explained,)


def _patches(
    capture: Capture, bands: CorrectedBands, noise: NoiseModel, linearity: Linearity | None
) -> tuple[PatchTable | None, list[str]]:
    """Measured patches with their notes, or a note that says why there are none."""
    labels = capture.manifest.labels
    try:
        patches = measure_patches(capture, bands, noise, linearity)
    except InputError as fault:
        if labels is None or labels.image is not None:
            raise
        return None, [f"no patch reflectances: {fault}"]
    if labels is None or all(label.excludes for label in capture.label_names()):
        return None, []
    if patches is None:
        return None, ["[labels] without a known white patch or without filters: no patch reflectances"]
    remarks = [] if labels.image is not None else ["[labels] states no image: a ColorChecker was found in the picture"]
    return patches, [*remarks, *patches.notes]


def _with_chart_sensitivities(capture: Capture, bands: CorrectedBands, noise: NoiseModel) -> tuple[Capture, list[str]]:
    """The capture with sensitivities from its chart, where it states none, and a note on them."""
    try:
        estimate = chart_sensitivities(capture, bands, noise)
    except InputError as fault:
        labels = capture.manifest.labels
        if labels is None or labels.image is not None:
            raise
        return capture, [f"no sensitivities from a chart: {fault}"]
    if estimate is None or isinstance(estimate, str):
        return capture, [] if estimate is None else [estimate]
    return replace(capture, chart_sensitivities=estimate.curves), [estimate.note]


def _chain(
    capture: Capture, patches: PatchTable | None, colour: ColourStudy | None, responses: Sequence[BandResponse] | None
) -> ChainCheck | None:
    """The check of the colour chain; None without patches of every band, lamp or weights."""
    lamp = capture.manifest.lamp
    if patches is None or colour is None or responses is None or lamp is None:
        return None
    if patches.bands != capture.band_ids:
        return None
    weights = colour.weights[colour.recommended]
    return check_chain(patches, weights, responses, capture.light(lamp.radiance), capture.label_reflectances())


def _nominal_axis(capture: Capture, fit: CameraFit | None) -> LensAxis | None:
    """Axis of the lens, for a capture without flats.

    It follows from the fitted camera. With a free scale it may follow from the nominal focal length; with an absolute
    one a rendering has to correct the nominal fall-off, which needs a camera.
    """
    manifest = capture.manifest
    if fit is not None:
        u, v = fit.camera.principal_point_px
        return LensAxis(fit.camera.focal_length_px, float(u), float(v))
    if manifest.is_absolute:
        return None
    focal, pitch, crop = manifest.lens.focal_length_mm, manifest.camera.pixel_pitch_um, manifest.crop
    if focal is None or pitch is None:
        return None
    height, width = capture.shape
    u, v = (width - 1) / 2, (height - 1) / 2
    if crop is not None:
        u, v = (crop.full_width_px - 1) / 2 - crop.u0_px, (crop.full_height_px - 1) / 2 - crop.v0_px
    return LensAxis(1e3 * focal / pitch, u, v)


def _scene_notes(capture: Capture) -> list[str]:
    """Note on a scene that is not known; empty without one."""
    scene = capture.manifest.scene
    if scene is None or scene.endswith(".toml") or capture.scene_reference is not None:
        return []
    return [
        f"the scene '{scene}' is neither a packaged one nor a scene file (.toml) of the capture: checks against "
        "the box were left out"
    ]


def _cell_notes(capture: Capture) -> list[str]:
    """Note on the colours behind a mosaic; empty without one."""
    if capture.cell is None or len(capture.band_ids) < 2:
        return []
    height, width = capture.cell
    return [
        f"XYZ and colour differences behind the mosaic are those of a cell of {height} x {width} px: the means of "
        "each band's pixels in it, given to all its pixels"
    ]


def _responses(
    capture: Capture, radiometry: Radiometry, channels: Mapping[str, str] | None
) -> tuple[tuple[BandResponse, ...] | None, list[str]]:
    """Absolute response of each band; None, with a note, if the tables do not give all of them."""
    missing = missing_keys(capture)
    if missing:
        return None, [f"no absolute signals and no XYZ: missing {', '.join(missing)}"]
    if radiometry.constant is None:
        return None, []
    responses = band_responses(capture, radiometry.constant, channels)
    blind = [response.band for response in responses if not response.response.any()]
    if blind:
        return None, [f"no absolute signals and no XYZ: by their tables {', '.join(blind)} see no visible light"]
    return responses, []


def calibrate_capture(capture: Capture, reference_relative_sigma: float = 0.0) -> Calibration:
    """Calibration of a capture, as far as its data allow.

    Missing data are not an error: the part is None and a note names what is missing.

    Parameters
    ----------
    capture
        Capture with its frames.
    reference_relative_sigma
        Relative scale uncertainty of the reference source's radiance, which the format does not state.

    Returns
    -------
    Calibration
        All results with notes and suspicions.

    Raises
    ------
    InputError
        For faulty frames and for surveyed points that cannot determine a camera.
    """
    capture = capture if capture.is_merged else with_full_well(capture)
    dark = read_darks(capture)
    noise = measure_merged_noise(capture) if capture.is_merged else measure_noise(capture, dark)
    channels = band_channels(capture)
    camera_fit, target_fit, camera_notes, explained = _camera(capture)
    bands = correct_bands(capture, dark, noise, channels, _nominal_axis(capture, camera_fit))
    capture, chart_notes = _with_chart_sensitivities(capture, bands, noise)
    radiometry = measure_constant(capture, bands, dark, noise, channels)
    if levels := channel_levels(capture, radiometry, channels):
        capture = replace(capture, channel_levels=levels)
        radiometry = measure_constant(capture, bands, dark, noise, channels)
    notes = [
        *([] if capture.reduction is None else [capture.reduction.note]),
        *file_mosaic_notes(capture),
        *level_notes(capture),
        *chart_notes,
        *noise.notes,
        *bands.notes,
        *chosen_channel_notes(capture, channels),
        *brighter_channel_notes(capture, channels),
        *radiometry.notes,
        *camera_notes,
        *_scene_notes(capture),
        *_cell_notes(capture),
    ]
    # merged pictures are no counts: their sensor cannot be studied
    linearity = None if capture.is_merged else measure_linearity(capture, dark, noise, channels)
    if linearity is None:
        notes.append("no usable [[bracket]]: linearity, black level and exposure offset cannot be computed")
    sensor = NO_STUDY if capture.is_merged else study_sensor(capture, bands, dark, noise, channels)
    notes += [text for text in sensor.verdicts if "does not hold" in text or "not monotonic" in text]
    patches, patch_notes = _patches(capture, bands, noise, linearity)
    notes += patch_notes
    responses, response_notes = _responses(capture, radiometry, channels)
    notes += response_notes
    colour = None
    if responses is not None:
        colour = study_colour(capture, responses, _typical_noise(bands.images))
        notes.append(colour.reason)
    chain = _chain(capture, patches, colour, responses)
    if chain is not None:
        notes.append(chain.note)
    return Calibration(
        capture,
        dark,
        noise,
        channels,
        bands,
        radiometry,
        responses,
        colour,
        camera_fit,
        target_fit,
        linearity,
        sensor,
        measure_uncertainty(radiometry, capture.band_ids, reference_relative_sigma),
        patches,
        tuple(dict.fromkeys(notes)),
        find_suspicions(capture, bands, dark, noise, radiometry, camera_fit, channels=channels, already=explained),
        chain,
    )
