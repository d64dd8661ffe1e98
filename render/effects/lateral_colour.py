"""Lateral colour: magnification changes with wavelength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..chain import Light
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Where the magnification is that of the calibrated camera, nm.
REFERENCE_NM = 550.0


def _resampling(size: int, centre_px: float, magnification: float) -> NDArray[np.float64]:
    """(size, size) cubic convolution (Keys 1981, a = -1/2) of a row magnified about centre_px.

    Its reach of two pixels keeps the lamp from ringing over the picture, as a spline's would. Beyond the
    border the outermost pixels are repeated.
    """
    place = centre_px + (np.arange(size) - centre_px) / magnification
    first = np.floor(place).astype(int)
    t = place - first
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
    beside = ppm_per_nm * (light.effective_nm - REFERENCE_NM) * 1e-6
    if light.moved is None:
        return light.with_signal(_resampled(light, beside))
    result = light.signal.copy()
    for side in (-1.0, 1.0):
        here = side * beside > 0
        if here.any():
            # proportional in between: no corner moves by more than a pixel
            most = float(np.abs(beside[here]).max())
            zoomed = replace(light.camera, focal_length_px=light.camera.focal_length_px * (1 + side * most))
            result[here] += (np.abs(beside[here]) / most)[:, None, None] * light.moved(zoomed)[here]
    return light.with_signal(result)


def _resampled(light: Light, beside: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band, y, x) magnified from pixels alone. Negative ringing at dark borders is cut off."""
    u, v = light.camera.principal_point_px
    height, width = light.signal.shape[1:]
    magnified = []
    for image, magnification in zip(light.signal, 1 + beside, strict=True):
        rows, columns = _resampling(height, v, magnification), _resampling(width, u, magnification)
        magnified.append(np.maximum(rows @ image @ columns.T, np.minimum(image, 0.0)))
    return np.stack(magnified)


EFFECT = Effect(
    id="lateral-colour",
    stage="optics",
    title="magnification changes with wavelength",
    summary="Magnification 1 + ppm (lambda - 550 nm) 1e-6 about the principal point, lambda the mean "
    "wavelength of each band: as if each had a focal length of its own. Where the scene behind a picture is not "
    "known it is resampled by cubic convolution.",
    parameters=(Parameter("ppm_per_nm", "1e-6 nm^-1", null=0.0, low=-200.0, high=200.0, step=2.0, tolerance=0.1),),
    apply=_apply,
    confirm="Photograph the surveyed points, or a chessboard, in every band: the points' distance from the "
    "centre changes with wavelength.",
    sources=("Keys 1981, Cubic convolution interpolation for digital image processing (the resampling)",),
)
