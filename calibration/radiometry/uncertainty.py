"""Uncertainty in three components, kept separate because they propagate differently.

    pixel    independent in every pixel: shot and read noise, rounding, noise of dark and flat
    band     one factor for all pixels of a band: filter curve, drift of the lamp, shutter
    common   one factor for all pixels and bands: the constant C, the scale of the reference source

In the mean of many pixels only the pixel component averages out. In a chromaticity or a ratio of bands only the
common component cancels. A signal is S (1 + band error) (1 + common error) + noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .radiometry import Radiometry

__all__ = ["CovarianceParts", "Uncertainty", "measure_uncertainty", "xyz_parts"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Relative uncertainty of band signals, without the pixel component."""

    #: Identifiers of the bands.
    bands: tuple[str, ...]
    #: (band, band) relative covariance of the band component.
    band_covariance: NDArray[np.float64]
    #: Relative standard deviation of the common component.
    common: float
    #: Degrees of freedom of `band_covariance`, for Student's t: it is estimated from a few bands.
    band_degrees: float = np.inf

    @property
    def band(self) -> NDArray[np.float64]:
        """(band,) relative sigma of the band component."""
        return np.sqrt(np.diag(self.band_covariance))


@dataclass(frozen=True, eq=False)
class CovarianceParts:
    """Covariances of X, Y, Z by component."""

    #: (..., 3, 3) covariance by noise, independent in every pixel.
    pixel: NDArray[np.float64]
    #: (..., 3, 3) covariance by one factor per band.
    band: NDArray[np.float64]
    #: (..., 3, 3) covariance by one factor for all bands.
    common: NDArray[np.float64]

    @property
    def total(self) -> NDArray[np.float64]:
        """Sum of the three components, which are independent."""
        return self.pixel + self.band + self.common


def xyz_parts(
    signal: ArrayLike, variance: ArrayLike, xyz_per_dn: ArrayLike, uncertainty: Uncertainty
) -> CovarianceParts:
    """Covariance of X, Y, Z of signals with independent pixel variances, by component.

    Parameters
    ----------
    signal
        (band, ...) signals of pixels or means over pixels, DN.
    variance
        (band, ...) variances of the signals, DN^2.
    xyz_per_dn
        (3, band) X, Y, Z per DN.
    uncertainty
        Band and common components.

    Returns
    -------
    CovarianceParts
        (..., 3, 3) covariances of the pixel, band and common components.
    """
    values, matrix = np.asarray(signal, float), np.asarray(xyz_per_dn, float)

    def spread(variances: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.einsum("ib,b...,jb->...ij", matrix, variances, matrix, optimize=True), np.float64)

    size, direction = np.linalg.eigh(uncertainty.band_covariance)
    root = direction * np.sqrt(np.maximum(size, 0.0))
    moved = np.einsum("ib,b...,bk->...ik", matrix, values, root, optimize=True)
    xyz = np.tensordot(values, matrix, axes=(0, 1))
    return CovarianceParts(
        spread(np.asarray(variance, float)),
        moved @ np.swapaxes(moved, -1, -2),
        uncertainty.common**2 * xyz[..., :, None] * xyz[..., None, :],
    )


def measure_uncertainty(
    radiometry: Radiometry, bands: tuple[str, ...], reference_relative_sigma: float = 0.0
) -> Uncertainty:
    """Band and common components from a capture's references.

    The bands' constants scatter by s about their mean C, with weights a. C includes the error of the mean, so that the
    error of a band is its difference from the mean: the covariance is s^2 (I - 1 a^T - a 1^T + a^T a 1 1^T).

    The common component is the noise of C, added in quadrature to `reference_relative_sigma`. Without references the
    error of the nominal C is unknown and not included.

    Parameters
    ----------
    radiometry
        Constant C with its bands.
    bands
        Identifiers of the bands.
    reference_relative_sigma
        Relative scale uncertainty of the reference source's spectrum, which the capture format does not state.

    Returns
    -------
    Uncertainty
        Band covariance and common standard deviation, relative.
    """
    weight = dict(zip((c.band for c in radiometry.by_band), radiometry.weights.tolist(), strict=True))
    share = np.array([weight.get(band, 0.0) for band in bands])
    unit = np.ones(len(bands))
    by_share = np.outer(unit, share)
    band = radiometry.scatter**2 * (np.eye(len(bands)) - by_share - by_share.T + share @ share * np.outer(unit, unit))
    noise = np.array([weight[c.band] * c.sigma for c in radiometry.by_band])
    common = float(np.sqrt(noise @ noise)) / radiometry.constant if radiometry.constant and noise.size else 0.0
    degrees = max(len(radiometry.by_band) - 1, 0) if radiometry.scatter > 0 else np.inf
    return Uncertainty(bands, band, float(np.hypot(common, reference_relative_sigma)), degrees)
