"""A flat-shaded picture of a box with camera noise: input of known statistics for tests of the comparison."""

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from cboxlab.calibration.colour.colorimetry import FilterWeights, fit_filter_weights
from cboxlab.calibration.instrument.band_images import Mask, band_images
from cboxlab.calibration.instrument.band_response import BandResponse
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.validation.compare.comparison import Comparison, compare
from cboxlab.validation.report.metrics import ValidationFacts

BANDS = ("f450", "f500", "f550", "f600", "f650")
SURFACES = ("floor", "ceiling", "back wall", "red wall", "green wall", "block")
GAIN_E_PER_DN = 12.0
READ_NOISE_E = 10.0

#: Reflectance by surface and band.
REFLECTANCE = np.array(
    [
        [0.55, 0.65, 0.72, 0.74, 0.75],
        [0.55, 0.65, 0.72, 0.74, 0.75],
        [0.55, 0.65, 0.72, 0.74, 0.75],
        [0.05, 0.05, 0.06, 0.40, 0.62],
        [0.10, 0.30, 0.45, 0.20, 0.12],
        [0.25, 0.31, 0.35, 0.36, 0.37],
    ]
)


def surfaces(size: int = 96) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """surface (y, x), single_surface (y, x) and where the lamp is (y, x)."""
    v, u = (np.indices((size, size)) - (size - 1) / 2) / (size / 2)
    surface = np.full((size, size), -1, np.int16)
    inside = np.maximum(np.abs(u), np.abs(v)) < 0.96
    for index, where in enumerate((v > np.abs(u), -v > np.abs(u), None, -u > np.abs(v), u > np.abs(v))):
        if where is not None:
            surface[inside & where] = index
    surface[inside & (np.abs(u) == np.abs(v))] = 0
    surface[np.maximum(np.abs(u), np.abs(v)) < 0.5] = 2
    surface[(np.abs(u + 0.2) < 0.18) & (v > 0.05) & (v < 0.7)] = 5
    lamp = (np.abs(u) < 0.2) & (v > -0.75) & (v < -0.62)
    surface[lamp] = -1
    padded = np.pad(surface, 1, mode="edge")
    single_surface = (surface == padded[1:-1, 2:]) & (surface == padded[2:, 1:-1])
    return surface, single_surface, lamp


@dataclass(frozen=True)
class FakeBox:
    """The truth in DN and what a comparison of it needs."""

    size: int = 96
    render_over_sensor: float = 0.3
    surface: np.ndarray = field(init=False)
    single_surface: np.ndarray = field(init=False)
    lamp: np.ndarray = field(init=False)
    truth: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        surface, single_surface, lamp = surfaces(self.size)
        v, u = np.indices((self.size, self.size)) / self.size
        light = np.array([700.0, 1500.0, 2400.0, 3000.0, 2600.0])[:, None, None]
        shade = 0.35 + 0.65 * np.exp(-((u - 0.5) ** 2 + (v - 0.25) ** 2) / 0.3)
        reflectance = np.where(surface >= 0, REFLECTANCE[np.maximum(surface, 0)].transpose(2, 0, 1), 0.0)
        truth = light * shade * reflectance
        truth[:, lamp] = 4095.0
        values = {"surface": surface, "single_surface": single_surface, "lamp": lamp, "truth": truth}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def sensor_variance(self) -> np.ndarray:
        return self.truth / GAIN_E_PER_DN + (READ_NOISE_E / GAIN_E_PER_DN) ** 2

    @property
    def mask(self) -> np.ndarray:
        mask = np.zeros(self.truth.shape, np.uint8)
        mask[:, self.lamp] = Mask.LAMP | Mask.SATURATED
        return mask

    def images(self, seed: int, factor: np.ndarray | float = 1.0) -> tuple[xr.Dataset, xr.Dataset]:
        """Measured (of the truth times ``factor``) and rendered band images with their Gaussian noise."""
        generator = np.random.default_rng(seed)
        sensor, render = self.sensor_variance, self.render_over_sensor**2 * self.sensor_variance
        measured = self.truth * factor + np.sqrt(sensor) * generator.standard_normal(sensor.shape)
        rendered = self.truth + np.sqrt(render) * generator.standard_normal(sensor.shape)
        return band_images(BANDS, measured, sensor, self.mask), band_images(BANDS, rendered, render)

    @property
    def xyz_per_dn(self) -> np.ndarray:
        """Rough weights of the right signs and proportions."""
        return 1e-4 * np.array(
            [
                [0.35, 0.02, 0.50, 1.00, 0.45],
                [0.04, 0.45, 1.05, 0.62, 0.16],
                [1.75, 0.25, 0.01, 0.0, 0.0],
            ]
        )

    @property
    def lamp_xyz(self) -> np.ndarray:
        return self.xyz_per_dn @ np.array([700.0, 1500.0, 2400.0, 3000.0, 2600.0])

    def compare(self, seed: int, factor: np.ndarray | float = 1.0, **changes: object) -> Comparison:
        measured, rendered = self.images(seed, factor)
        arguments: dict = {
            "xyz_per_dn": self.xyz_per_dn,
            "lamp_xyz": self.lamp_xyz,
            "surface": self.surface,
            "surface_names": SURFACES,
            "single_surface": self.single_surface,
            **changes,
        }
        return compare(measured, rendered, self.sensor_variance, **arguments)


def fake_run(**changes: object) -> ValidationFacts:
    """A run with a calibrated and a slightly moved camera."""
    sigma = np.array([0.4, 0.4, 0.8, 0.03, 0.03, 0.01, 0.2, 0.3, 0.3, 0.002])
    camera = Camera(
        96,
        96,
        134.4,
        np.array([47.5, 47.6]),
        -0.02,
        REFERENCE_ROTATION,
        np.array([278.0, 273.0, -800.0]),
        np.diag(sigma**2),
    )
    moved = camera.with_parameters(camera.parameters + 0.5 * sigma)
    arguments: dict = {
        "capture": "captures/fake",
        "model": "published Cornell Box",
        "version": "0.1.0",
        "camera": moved,
        "reprojection_rms_px": 0.148,
        "lamp_scale": 1.004,
        "lamp_scale_sigma": 0.001,
        "lamp_scale_prior_sigma": 0.02,
        "calibrated_camera": camera,
    }
    return ValidationFacts(**{**arguments, **changes})


def fake_weights() -> tuple[FilterWeights, list[BandResponse]]:
    """Weights fitted to Gaussian filters."""
    responses = [
        BandResponse(band, INTEGRAL_GRID, 1e18 * np.exp(-0.5 * ((WAVELENGTH_NM - float(band[1:])) / 22) ** 2), 1.0)
        for band in BANDS
    ]
    return fit_filter_weights(responses, 0.01), responses
