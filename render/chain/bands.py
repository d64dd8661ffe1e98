"""From spectral radiance to the camera's own counts."""

from __future__ import annotations

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import BandResponse, Mask, band_images, sensor_matrix
from cboxlab.utils.progress import checkpoint
from scipy.ndimage import binary_dilation, uniform_filter

from ..image import RenderedImage

__all__ = ["render_bands"]


def render_bands(image: RenderedImage, responses: tuple[BandResponse, ...]) -> xr.Dataset:
    """Expected signals through the sensor equation, with their Monte Carlo variance.

    For the render's noise alone; ``expected_signal`` gives the signals under effects, without it the same ones. Pixels
    that see the lamp, and their neighbours, are masked: a shift of the camera by a part of a pixel brings the lamp into
    them.

    Parameters
    ----------
    image
        Rendered image on the grid of the responses.
    responses
        One response a band.

    Returns
    -------
    xr.Dataset
        Signal (band, y, x) in DN, its variance and its mask.

    Raises
    ------
    ValueError
        If the image and the responses have different wavelengths.
    """
    if not responses[0].grid.matches(image.wavelength_nm):
        raise ValueError("the image and the responses have different wavelengths")
    mean, variance = image.project(sensor_matrix(responses).T)
    checkpoint()
    variance = _pooled(mean, variance, image.single_surface)
    checkpoint()
    near_lamp = binary_dilation(image.sees_lamp, np.ones((3, 3)))
    mask = np.where(near_lamp, np.uint8(Mask.LAMP), np.uint8(0))
    stack = np.broadcast_to(mask, (len(responses), *mask.shape))
    return band_images([r.band for r in responses], np.moveaxis(mean, -1, 0), np.moveaxis(variance, -1, 0), stack)


def _pooled(mean: np.ndarray, variance: np.ndarray, single_surface: np.ndarray) -> np.ndarray:
    """Variances (y, x, band) with their relative values averaged over 3 x 3 pixels inside faces.

    A variance from a few batches is itself noisy, and a chi-square that divides by it comes out too large;
    neighbouring pixels of one face have nearly the same.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(single_surface[..., None] & (mean > 0), variance / mean**2, 0.0)
        share = np.maximum(uniform_filter(single_surface.astype(float), 3), 1 / 9)
        smooth = np.maximum(uniform_filter(relative, (3, 3, 1)), 0) / share[..., None]
    return np.where(single_surface[..., None] & (mean > 0), smooth * mean**2, variance)
