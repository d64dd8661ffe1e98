"""Lateral colour: magnification changes with wavelength."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._effect import Effect, Light, Parameter

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
    u, v = light.camera.principal_point_px
    height, width = light.signal.shape[1:]
    magnified = []
    for image, wavelength in zip(light.signal, light.effective_nm, strict=True):
        magnification = 1 + ppm_per_nm * (wavelength - REFERENCE_NM) * 1e-6
        rows, columns = _resampling(height, v, magnification), _resampling(width, u, magnification)
        magnified.append(rows @ image @ columns.T)
    return light.with_signal(np.stack(magnified))


EFFECT = Effect(
    id="lateral-colour",
    stage="optics",
    summary="Magnification 1 + ppm (lambda - 550 nm) 1e-6 about the principal point, lambda the mean "
    "wavelength of each band; resampled by cubic convolution, the outermost pixels repeated beyond the "
    "border.",
    parameters=(Parameter("ppm_per_nm", "1e-6 nm^-1", null=0.0, low=-200.0, high=200.0, step=2.0),),
    apply=_apply,
    confirm="Photograph the surveyed points, or a chessboard, in every band: the points' distance from the "
    "centre changes with wavelength.",
    sources=("Keys 1981, Cubic convolution interpolation for digital image processing (the resampling)",),
)
