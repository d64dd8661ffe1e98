"""From spectral radiance to the camera's own counts."""

from __future__ import annotations

import numpy as np
import xarray as xr
from cboxlab.calibration.band_images import Mask, band_images
from cboxlab.calibration.sensor_equation import BandResponse, sensor_matrix
from scipy.ndimage import binary_dilation

from .image import RenderedImage

__all__ = ["render_bands"]


def render_bands(image: RenderedImage, responses: tuple[BandResponse, ...]) -> xr.Dataset:
    """Expected signals (band, y, x) in DN through the sensor equation, with the Monte Carlo variance.

    The image's wavelengths must be the grid of the responses. Pixels that see the lamp, and their neighbours,
    are masked: a shift of the camera by a part of a pixel brings the lamp into them.
    Raises ValueError where the grids differ.
    """
    grid = responses[0].wavelength_nm
    if not np.array_equal(image.wavelength_nm, grid):
        raise ValueError("the image and the responses have different wavelengths")
    mean, variance = image.project(sensor_matrix(responses).T)
    near_lamp = binary_dilation(image.sees_lamp, np.ones((3, 3)))
    mask = np.where(near_lamp, np.uint8(Mask.LAMP), np.uint8(0))
    stack = np.broadcast_to(mask, (len(responses), *mask.shape))
    return band_images(
        [r.band for r in responses], np.moveaxis(mean, -1, 0), np.moveaxis(variance, -1, 0), stack
    )
