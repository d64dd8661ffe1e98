"""Everything a capture says about its camera, and what it lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.scenes.camera import Camera
from numpy.typing import ArrayLike, NDArray

from .camera_calibration import calibrate_camera
from .capture import Capture
from .colorimetry import FilterWeights, xyz_image
from .colour_study import ColourStudy, study_colour
from .corrected_bands import CorrectedBands, correct_bands
from .dark import DarkLibrary, read_darks
from .geometry import CameraFit
from .linearity import Linearity, measure_linearity
from .mosaic import band_channels, brighter_channel_notes
from .noise import NoiseModel, measure_noise
from .patches import PatchTable, measure_patches
from .radiometry import Radiometry, measure_constant
from .sensor_equation import BandResponse, band_responses, missing_keys
from .sensor_study import SensorStudy, study_sensor
from .target_camera import TargetFit
from .uncertainty import Uncertainty, measure_uncertainty

__all__ = ["Calibration", "calibrate"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """What ``calibrate`` found; None where the capture lacks what it takes, and ``notes`` say so.

    channels : by band, the channel of a sensor with a mosaic. responses : one per band, with K_i.
    colour : filter weights three ways with their errors. camera_fit : from the survey.
    target_fit : from flat targets, joined with the survey where there is one. sensor : photon transfer, dark
    level, response, calibration curve. uncertainty : what bands, and all bands, share.
    """

    capture: Capture
    dark: DarkLibrary
    noise: NoiseModel
    channels: dict[str, str] | None
    bands: CorrectedBands
    radiometry: Radiometry
    responses: tuple[BandResponse, ...] | None
    colour: ColourStudy | None
    camera_fit: CameraFit | None
    target_fit: TargetFit | None
    linearity: Linearity | None
    sensor: SensorStudy
    uncertainty: Uncertainty
    patches: PatchTable | None
    notes: tuple[str, ...]

    @property
    def camera(self) -> Camera | None:
        """The calibrated camera with its covariance: of the survey, refined by flat targets."""
        if self.target_fit is not None and self.target_fit.survey_camera is not None:
            return self.target_fit.survey_camera
        return None if self.camera_fit is None else self.camera_fit.camera

    @property
    def images(self) -> xr.Dataset:
        """The measured BandImages (band, y, x), bands in the manifest's order."""
        return self.bands.images

    @property
    def photograph(self) -> NDArray[np.float64]:
        """(y, x) mean of the bands, each over its own 99th percentile: a picture to look at."""
        signal = self.images["signal"].values
        return np.asarray(
            np.mean(signal / np.percentile(signal, 99, axis=(1, 2), keepdims=True), axis=0), np.float64
        )

    def predicted_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Variance (band, y, x) in DN^2 of the corrected signals for their expectation (band, y, x) in DN."""
        return self.bands.predicted_variance(expected_signal)

    @property
    def weights(self) -> FilterWeights | None:
        """The filter weights in use: those with the least colour error of the three."""
        return None if self.colour is None else self.colour.weights[self.colour.recommended]

    def xyz(self) -> xr.Dataset:
        """Measured tristimulus images, see ``xyz_image``. ValueError where the capture cannot give them."""
        if self.weights is None or self.responses is None:
            raise ValueError("the capture lacks what XYZ takes: see notes")
        relative = None if self.colour is None else self.colour.errors[self.colour.recommended].relative
        return xyz_image(self.images, self.weights, self.responses, self.uncertainty, relative)


def _typical_noise(images: xr.Dataset) -> NDArray[np.float64]:
    """(band,) median relative standard deviation over the unmasked, lit pixels of each band."""
    noise = []
    for band in range(images.sizes["band"]):
        signal, variance = images["signal"].values[band], images["variance"].values[band]
        lit = (images["mask"].values[band] == 0) & (signal > 3 * np.sqrt(variance))
        noise.append(float(np.median(np.sqrt(variance[lit]) / signal[lit])) if np.any(lit) else 1.0)
    return np.array(noise)


def calibrate(capture: Capture, reference_relative_sigma: float = 0.0) -> Calibration:
    """Everything that the capture allows to be computed.

    reference_relative_sigma : of the scale of the reference source's radiance, which the format does not hold.

    What a capture lacks is no error: the result is then None and a note says what is missing. Raises
    InputError for faulty frames or surveyed points that cannot determine a camera.
    """
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    channels = band_channels(capture)
    bands = correct_bands(capture, dark, noise, channels)
    radiometry = measure_constant(capture, bands, dark, noise, channels)
    camera_fit, target_fit, camera_notes = calibrate_camera(capture)
    notes = [
        *noise.notes,
        *bands.notes,
        *brighter_channel_notes(capture, channels),
        *radiometry.notes,
        *camera_notes,
    ]
    responses = colour = None
    linearity = measure_linearity(capture, dark, noise, channels)
    if linearity is None:
        notes.append("no usable [[bracket]]: linearity, black level and exposure offset cannot be computed")
    sensor = study_sensor(capture, bands, dark, noise, channels)
    notes += [text for text in sensor.verdicts if "does not hold" in text or "not monotonic" in text]
    patches = measure_patches(capture, bands, noise, linearity)
    if patches is not None:
        notes += patches.notes
    elif capture.manifest.labels is not None:
        notes.append("[labels] without a known white patch or without filters: no patch reflectances")
    missing = missing_keys(capture)
    if missing:
        notes.append(f"no absolute signals and no XYZ, for want of {', '.join(missing)}")
    elif radiometry.constant is not None:
        responses = band_responses(capture, radiometry.constant, channels)
    if responses is not None:
        colour = study_colour(capture, responses, _typical_noise(bands.images))
        notes.append(colour.reason)
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
    )
