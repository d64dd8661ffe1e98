"""Lateral colour: magnification changes with wavelength.

The magnification about the principal point is 1 + p (lambda - 550 nm) 1e-6, lambda the mean wavelength of the band's
signal. The change of the band farthest from 550 nm on either side is that of a camera of another focal length. Other
bands change in proportion. If the scene behind the picture is not known, its pixels are resampled. The cause is a focal
length that changes with wavelength.

Parameters: ppm_per_nm p, 1e-6 nm^-1, null value 0.
Source: Keys 1981, Cubic convolution interpolation for digital image processing (the resampling).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..chain import Light
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Wavelength at which the magnification is that of the calibrated camera, nm: the middle of 400 to 700 nm.
REFERENCE_NM = 550.0


def _resampling(size: int, centre_px: float, magnification: float) -> NDArray[np.float64]:
    """(size, size) cubic convolution (Keys 1981, a = -1/2) of a row magnified about centre_px.

    The kernel reaches two pixels, so the lamp does not ring over the picture as with a spline. Beyond the border the
    outermost pixels are repeated.
    """
    source_px = centre_px + (np.arange(size) - centre_px) / magnification
    first = np.floor(source_px).astype(int)
    t = source_px - first
    shares = (
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )
    matrix = np.zeros((size, size))
    for offset, share in zip((-1, 0, 1, 2), shares, strict=True):
        np.add.at(matrix, (np.arange(size), np.clip(first + offset, 0, size - 1)), share)
    return matrix


def _apply(light: Light, ppm_per_nm: float) -> Light:
    """Light with each band magnified: by moved cameras if the light has them, else resampled."""
    zoom = ppm_per_nm * (light.effective_nm - REFERENCE_NM) * 1e-6
    if light.moved is None:
        return light.with_signal(_resampled(light, zoom))
    result = light.signal.copy()
    for side in (-1.0, 1.0):
        bands = side * zoom > 0
        if bands.any():
            # proportional in between: no corner moves by more than a pixel
            most = float(np.abs(zoom[bands]).max())
            zoomed = replace(light.camera, focal_length_px=light.camera.focal_length_px * (1 + side * most))
            result[bands] += (np.abs(zoom[bands]) / most)[:, None, None] * light.moved(zoomed)[bands]
    return light.with_signal(result)


def _resampled(light: Light, zoom: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band, y, x) signal magnified by resampling; negative ringing at dark borders is cut off."""
    u, v = light.camera.principal_point_px
    height, width = light.signal.shape[1:]
    magnified = []
    for image, magnification in zip(light.signal, 1 + zoom, strict=True):
        rows, columns = _resampling(height, v, magnification), _resampling(width, u, magnification)
        magnified.append(np.maximum(rows @ image @ columns.T, np.minimum(image, 0.0)))
    return np.stack(magnified)


EFFECT = Effect(
    id="lateral-colour",
    stage="optics",
    title="magnification changes with wavelength",
    summary="Each band has another focal length: magnification 1 + ppm (lambda - 550 nm) 1e-6 about the principal "
    "point, lambda the band's mean wavelength. If the scene behind a picture is not known, cubic convolution "
    "resamples its pixels.",
    parameters=(Parameter("ppm_per_nm", "1e-6 nm^-1", null=0.0, low=-200.0, high=200.0, step=2.0, tolerance=0.1),),
    apply=_apply,
    confirm="Photograph the surveyed points, or a chessboard, in every band: the points' distance from the "
    "centre changes with wavelength.",
    sources=("Keys 1981, Cubic convolution interpolation for digital image processing (the resampling)",),
)
