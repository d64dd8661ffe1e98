"""Model of the instrument that calibration and rendering share."""

from .band_images import Mask, band_images
from .band_response import (
    BandResponse,
    ResponseFactors,
    lens_constant,
    quanta_per_joule,
    response_factors,
    rest_curve,
    sensor_matrix,
    tabulation_errors,
)
from .observer import LUMINOUS_EFFICACY, OBSERVER_RANGE_NM, chromaticity, colour_matching_functions

__all__ = [
    "LUMINOUS_EFFICACY",
    "OBSERVER_RANGE_NM",
    "BandResponse",
    "Mask",
    "ResponseFactors",
    "band_images",
    "chromaticity",
    "colour_matching_functions",
    "lens_constant",
    "quanta_per_joule",
    "response_factors",
    "rest_curve",
    "sensor_matrix",
    "tabulation_errors",
]
