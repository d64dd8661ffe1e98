"""From spectral light to the signals of the bands: the integral over wavelength and angle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.calibration.instrument import sensor_matrix
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID
from numpy.typing import NDArray

from ..image import RenderedImage
from .band_curves import BandCurves, field_shares
from .light import Light

__all__ = ["Projection", "band_signals", "scene_light", "uniform_light"]

#: Radiance (y or 1, x or 1, 301) on INTEGRAL_GRID times weights (301, q), one column a band: (y or 1, x or 1, q).
Projection = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def band_signals(project: Projection, curves: BandCurves, shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signals of the radiance that a projection integrates.

    Parameters
    ----------
    project
        Projection of the radiance; it is called once for each field angle with shares.
    curves
        Responses at field angles.
    shares
        (angle, y, x) ``field_shares`` of the curves.

    Returns
    -------
    NDArray
        (band, y, x) signals above dark at a flat of 1, DN. One row and one column where neither radiance nor shares
        vary over the field.
    """
    signal: NDArray[np.float64] = np.zeros(())
    for angle, share in enumerate(shares):
        weights = sensor_matrix(curves.responses(angle)).T
        signal = signal + share * np.moveaxis(project(weights), -1, 0)
    return signal


def uniform_light(radiance: NDArray[np.float64]) -> Projection:
    """Projection of a source that fills the field evenly.

    Parameters
    ----------
    radiance
        (301,) W m^-2 sr^-1 nm^-1, or (band, 301) where each band has another one.

    Returns
    -------
    Projection
        Projection of one row and one column.
    """
    return lambda weights: np.einsum("...w,w...->...", radiance, weights)[None, None]


def _of_image(image: RenderedImage) -> Projection:
    """Projection of a rendered image. Raises ValueError for other wavelengths than the grid's."""
    if not INTEGRAL_GRID.matches(image.wavelength_nm):
        raise ValueError("the image's wavelengths are not 400 to 700 nm by 1 nm")
    return image.mean


def _effective_nm(project: Projection, curves: BandCurves) -> NDArray[np.float64]:
    """(band,) mean wavelength of each band's signal on the axis, the median pixel's.

    The lamp, brighter than all the rest together, must not decide.
    """
    axial = sensor_matrix(curves.responses()).T
    moments = project(np.concatenate([axial, INTEGRAL_GRID.nm[:, None] * axial], axis=1))
    level, first = np.split(moments, 2, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nanmedian(np.where(level > 0, first / level, np.nan), axis=(0, 1)))


def scene_light(scene: RenderedImage | Projection, curves: BandCurves, camera: Camera) -> Light:
    """Light of the scene through the filters, before optics and counts.

    Parameters
    ----------
    scene
        A rendered image on INTEGRAL_GRID, or a projection of the radiance of its pixels.
    curves
        Responses with the filters' effects.
    camera
        Camera, for the field angles.

    Returns
    -------
    Light
        Value of the optics stage without effects.

    Raises
    ------
    ValueError
        If the image has other wavelengths.
    """
    project = _of_image(scene) if isinstance(scene, RenderedImage) else scene
    signal = band_signals(project, curves, field_shares(curves, camera))
    return Light(signal, _effective_nm(project, curves), camera)
