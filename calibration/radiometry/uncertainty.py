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
    """band_covariance : (band, band), relative, of the band component. common : relative sigma, common component.

    band_degrees : degrees of freedom of band_covariance, for Student's t: it is estimated from a few bands.
    """

    bands: tuple[str, ...]
    band_covariance: NDArray[np.float64]
    common: float
    band_degrees: float = np.inf

    @property
    def band(self) -> NDArray[np.float64]:
        """(band,) relative sigma of the band component."""
        return np.sqrt(np.diag(self.band_covariance))


@dataclass(frozen=True, eq=False)
class CovarianceParts:
    """(..., 3, 3) covariances of X, Y, Z by component."""

    pixel: NDArray[np.float64]
    band: NDArray[np.float64]
    common: NDArray[np.float64]

    @property
    def total(self) -> NDArray[np.float64]:
        """Sum of the three components, which are independent."""
        return self.pixel + self.band + self.common


def xyz_parts(
    signal: ArrayLike, variance: ArrayLike, xyz_per_dn: ArrayLike, uncertainty: Uncertainty
) -> CovarianceParts:
    """Covariance of X, Y, Z of signals (band, ...) with independent pixel variances (band, ...), by component.

    signal, variance : DN and DN^2, of pixels or of means over pixels. xyz_per_dn : (3, band).
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
    """The band and common components, from a capture's references.

    band : with the scatter s between the bands' constants and their weights a in the mean C, the error of a band is
    its own error minus that of the mean, since C includes the latter: the covariance is
    s^2 (I - 1 a^T - a 1^T + a^T a 1 1^T). common : noise of C, added in quadrature to reference_relative_sigma, the
    scale uncertainty of the reference source's spectrum, which the capture format does not state. Without
    references the error of the nominal C is unknown and not included.
    """
    weight = dict(zip((c.band for c in radiometry.by_band), radiometry.weights.tolist(), strict=True))
    share = np.array([weight.get(band, 0.0) for band in bands])
    ones = np.ones(len(bands))
    taken = np.outer(ones, share)
    band = radiometry.scatter**2 * (np.eye(len(bands)) - taken - taken.T + share @ share * np.outer(ones, ones))
    noise = np.array([weight[c.band] * c.sigma for c in radiometry.by_band])
    common = float(np.sqrt(noise @ noise)) / radiometry.constant if radiometry.constant and noise.size else 0.0
    degrees = max(len(radiometry.by_band) - 1, 0) if radiometry.scatter > 0 else np.inf
    return Uncertainty(bands, band, float(np.hypot(common, reference_relative_sigma)), degrees)
