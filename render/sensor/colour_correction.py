"""From counts to linear channels at every pixel, and from channels to CIE XYZ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from .detector import SensorCamera

__all__ = ["ColourCorrection", "chart_reflectances", "demosaic", "fit_correction", "linear_counts"]


def linear_counts(counts: ArrayLike, camera: SensorCamera, exposure_s: float) -> NDArray[np.float64]:
    """Counts proportional to light: F inverted, the dark level subtracted.

    Parameters
    ----------
    counts
        Recorded counts of any shape, DN.
    camera
        Camera with the response curve F and the dark level.
    exposure_s
        Exposure, s.

    Returns
    -------
    NDArray
        Linear DN of the same shape.
    """
    detector = camera.detector
    return detector.linearise(counts) - detector.dark(exposure_s)[0]


def demosaic(linear: NDArray[np.float64], camera: SensorCamera, white_dn: float) -> NDArray[np.float64]:
    """Channels of a mosaic frame, by OpenCV's bilinear interpolation.

    Parameters
    ----------
    linear
        (y, x) linear DN; clipped to 0 to ``white_dn`` and rounded to 16 bits.
    camera
        Camera with a mosaic.
    white_dn
        Linear DN of white.

    Returns
    -------
    NDArray
        (y, x, 3) R, G, B in linear DN.

    Raises
    ------
    InputError
        If the mosaic is not 2 x 2 letters R, G and B.
    """
    import cv2  # slow to import, and only needed here

    pattern = camera.pattern or ()
    is_square = [len(row) for row in pattern] == [2, 2]
    code = getattr(cv2, f"COLOR_Bayer{''.join(pattern)}2RGB", None) if is_square else None
    if code is None or set(camera.channels) != set("RGB"):
        raise InputError(f"camera {camera.name}: mosaic.pattern", repr(list(pattern)), "2 x 2 letters R, G, B (Bayer)")
    integers = np.rint(np.clip(linear / white_dn, 0, 1) * 65535).astype(np.uint16)
    return np.asarray(cv2.cvtColor(integers, code), float) / 65535.0 * white_dn


def chart_reflectances() -> NDArray[np.float64]:
    """Reflectances of the ColorChecker, averages by BabelColor (colour-science).

    Returns
    -------
    NDArray
        (24, 301) reflectances on WAVELENGTH_NM.
    """
    from colour import SDS_COLOURCHECKERS  # slow to import, and only needed here

    chart = SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.array([np.interp(WAVELENGTH_NM, patch.wavelengths, patch.values) for patch in chart])


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """Linear correction: XYZ = matrix @ channels."""

    #: (3, c) XYZ per linear DN of the channels.
    matrix: NDArray[np.float64]
    #: (c,) variance of the noise assumed in the fit, DN^2.
    noise_variance: NDArray[np.float64]

    def xyz(self, channels: ArrayLike) -> NDArray[np.float64]:
        """XYZ of linear channels.

        Parameters
        ----------
        channels
            (..., c) linear DN.

        Returns
        -------
        NDArray
            (..., 3) XYZ; Y is 1 for a perfect white.
        """
        return np.asarray(channels, float) @ self.matrix.T


def fit_correction(
    channels: NDArray[np.float64],
    reflectances: NDArray[np.float64],
    illuminant: Spectrum,
    noise_variance: ArrayLike = 0.0,
) -> ColourCorrection:
    """Linear minimum mean square error estimate of XYZ from a camera's channels.

    matrix = E[x r^T] (E[r r^T] + N)^-1 over a training set, with r the channels, x the XYZ and N the noise. The light
    of x may be another one than that of r, as in Vora et al. 2001.

    Parameters
    ----------
    channels
        (n, c) expected channels of the training set under the light of the photograph, linear DN.
    reflectances
        (n, 301) reflectances of the training set on WAVELENGTH_NM.
    illuminant
        Light of the XYZ; Y = 1 for a perfect white.
    noise_variance
        Variance of the noise by channel, DN^2.

    Returns
    -------
    ColourCorrection
        The fitted matrix.
    """
    light = illuminant.at(WAVELENGTH_NM)
    observer = colour_matching_functions()
    xyz = (reflectances * light) @ observer.T / float(light @ observer[1])
    variance = np.broadcast_to(np.asarray(noise_variance, float), (channels.shape[1],))
    # as least squares, since normal equations would square the condition number
    rows = np.vstack([channels, np.diag(np.sqrt(len(channels) * variance))])
    right = np.vstack([xyz, np.zeros((channels.shape[1], 3))])
    return ColourCorrection(np.linalg.lstsq(rows, right, rcond=None)[0].T, variance.copy())
