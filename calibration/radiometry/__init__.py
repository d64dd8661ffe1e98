"""From corrected counts to radiance: the sensor equation, the constant C, spectral sensitivities."""

from .band_response import (
    BandResponse,
    ResponseFactors,
    quanta_per_joule,
    response_factors,
    rest_curve,
    sensor_matrix,
    tabulation_errors,
)
from .hyperspectral import HyperspectralCube, as_scene, hyperspectral_cube, region_mask
from .radiometry import Radiometry, measure_constant
from .registration import register
from .sensor_equation import (
    band_responses,
    capture_factors,
    counts_over_constant,
    lens_constant,
    missing_keys,
    optical_factor,
    response_curve,
)
from .uncertainty import Uncertainty, measure_uncertainty, xyz_parts

__all__ = [
    "BandResponse",
    "HyperspectralCube",
    "Radiometry",
    "ResponseFactors",
    "Uncertainty",
    "as_scene",
    "band_responses",
    "capture_factors",
    "counts_over_constant",
    "hyperspectral_cube",
    "lens_constant",
    "measure_constant",
    "measure_uncertainty",
    "missing_keys",
    "optical_factor",
    "quanta_per_joule",
    "region_mask",
    "register",
    "response_curve",
    "response_factors",
    "rest_curve",
    "sensor_matrix",
    "tabulation_errors",
    "xyz_parts",
]
