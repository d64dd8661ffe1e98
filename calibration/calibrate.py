"""Everything a capture says about its camera, and what it lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from .capture import Capture
from .colorimetry import FilterWeights, fit_filter_weights, xyz_image
from .corrected_bands import CorrectedBands, correct_bands
from .dark import DarkLibrary, read_darks
from .geometry import CameraFit, fit_camera, read_points
from .mosaic import strongest_channels
from .noise import NoiseModel, measure_noise
from .radiometry import Radiometry, measure_constant
from .sensor_equation import BandResponse, band_responses, missing_keys

__all__ = ["Calibration", "calibrate"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """What ``calibrate`` found; None where the capture lacks what it takes, and ``notes`` say so.

    channels : by band, the channel of a sensor with a mosaic. responses : one per band, with K_i.
    plain_weights : filter weights without, ``weights`` with a regard for noise.
    """

    capture: Capture
    dark: DarkLibrary
    noise: NoiseModel
    channels: dict[str, str] | None
    bands: CorrectedBands
    radiometry: Radiometry
    responses: tuple[BandResponse, ...] | None
    plain_weights: FilterWeights | None
    weights: FilterWeights | None
    camera_fit: CameraFit | None
    notes: tuple[str, ...]

    @property
    def images(self) -> xr.Dataset:
        """The measured BandImages (band, y, x), bands in the manifest's order."""
        return self.bands.images

    def predicted_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Variance (band, y, x) in DN^2 of the corrected signals for their expectation (band, y, x) in DN."""
        return self.bands.predicted_variance(expected_signal)

    def xyz(self) -> xr.Dataset:
        """Measured tristimulus images, see ``xyz_image``. ValueError where the capture cannot give them."""
        if self.weights is None or self.responses is None:
            raise ValueError("the capture lacks what XYZ takes: see notes")
        return xyz_image(self.images, self.weights, self.responses)


def _typical_noise(images: xr.Dataset) -> NDArray[np.float64]:
    """(band,) median relative standard deviation over the unmasked, lit pixels of each band."""
    noise = []
    for band in range(images.sizes["band"]):
        signal, variance = images["signal"].values[band], images["variance"].values[band]
        lit = (images["mask"].values[band] == 0) & (signal > 3 * np.sqrt(variance))
        noise.append(float(np.median(np.sqrt(variance[lit]) / signal[lit])) if np.any(lit) else 1.0)
    return np.array(noise)


def _fit_camera(capture: Capture) -> tuple[CameraFit | None, list[str]]:
    geometry, camera = capture.manifest.geometry, capture.manifest.camera
    if geometry is None:
        return None, ["no [geometry]: the camera's pose cannot be computed"]
    nominal = None
    if capture.manifest.lens.focal_length_mm is not None and camera.pixel_pitch_um is not None:
        nominal = capture.manifest.lens.focal_length_mm / (camera.pixel_pitch_um * 1e-3)
    fit = fit_camera(
        read_points(capture.folder / geometry.points),
        width_px=camera.width_px,
        height_px=camera.height_px,
        point_sigma_px=geometry.point_sigma_px,
        focal_length_px=nominal,
    )
    notes = [f"surveyed points left out as mistakes: {', '.join(fit.outliers)}"] if fit.outliers else []
    return fit, notes


def calibrate(capture: Capture) -> Calibration:
    """Everything that the capture allows to be computed.

    What a capture lacks is no error: the result is then None and a note says what is missing. Raises
    InputError for faulty frames or surveyed points that cannot determine a camera.
    """
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    channels = strongest_channels(capture)
    bands = correct_bands(capture, dark, noise, channels)
    radiometry = measure_constant(capture, bands, dark, noise, channels)
    camera_fit, camera_notes = _fit_camera(capture)
    notes = [*noise.notes, *bands.notes, *radiometry.notes, *camera_notes]
    responses = plain = weights = None
    missing = missing_keys(capture)
    if missing:
        notes.append(f"no absolute signals and no XYZ, for want of {', '.join(missing)}")
    elif radiometry.constant is not None:
        responses = band_responses(capture, radiometry.constant, channels)
    if responses is not None:
        plain = fit_filter_weights(responses)
        weights = fit_filter_weights(responses, _typical_noise(bands.images))
    return Calibration(
        capture, dark, noise, channels, bands, radiometry, responses, plain, weights, camera_fit, tuple(notes)
    )
