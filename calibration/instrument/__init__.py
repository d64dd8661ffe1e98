"""Model of the instrument that calibration and rendering share."""

from .band_images import Mask, band_images
from .band_response import (
    BandResponse,
    ResponseFactors,
    band_centres,
    lens_constant,
    quanta_per_joule,
    response_factors,
    rest_curve,
    sensor_matrix,
    tabulation_errors,
)
from .mosaic_cells import CellMeans, cell_means, interpolated_channel, one_pixel_of_each_cell
from .observer import LUMINOUS_EFFICACY, OBSERVER_RANGE_NM, chromaticity, colour_matching_functions

__all__ = [
    "LUMINOUS_EFFICACY",
    "OBSERVER_RANGE_NM",
    "BandResponse",
    "CellMeans",
    "Mask",
    "ResponseFactors",
    "band_centres",
    "band_images",
    "cell_means",
    "chromaticity",
    "colour_matching_functions",
    "interpolated_channel",
    "lens_constant",
    "one_pixel_of_each_cell",
    "quanta_per_joule",
    "response_factors",
    "rest_curve",
    "sensor_matrix",
    "tabulation_errors",
]
