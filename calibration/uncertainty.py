"""Uncertainty in three kinds, carried apart to the end, since they add up differently.

    pixel    independent in every pixel: shot and read noise, rounding, noise of dark and flat
    band     the same factor on all pixels of a band: its flat's level, its filter's curve
    common   one factor on everything: the constant C, the reference source's scale

In the mean of many pixels the first averages away, the second does not, and in a chromaticity or a ratio of
bands the third cancels and the second does not. A signal is S (1 + band error) (1 + common error) + noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .radiometry import BandConstant, Radiometry

__all__ = ["CovarianceParts", "Uncertainty", "band_scatter", "measure_uncertainty", "xyz_parts"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """band : (band,) relative sigma, independent between bands. common : relative sigma of everything."""

    bands: tuple[str, ...]
    band: NDArray[np.float64]
    common: float


@dataclass(frozen=True, eq=False)
class CovarianceParts:
    """(..., 3, 3) covariances of X, Y, Z by kind; ``total`` is their sum."""

    pixel: NDArray[np.float64]
    band: NDArray[np.float64]
    common: NDArray[np.float64]

    @property
    def total(self) -> NDArray[np.float64]:
        """The three kinds are independent of each other."""
        return self.pixel + self.band + self.common


def xyz_parts(
    signal: ArrayLike, variance: ArrayLike, xyz_per_dn: ArrayLike, uncertainty: Uncertainty
) -> CovarianceParts:
    """Covariance of X, Y, Z of signals (band, ...) with independent pixel variances (band, ...), by kind.

    signal, variance : DN and DN^2, of pixels or of means over pixels. xyz_per_dn : (3, band).
    """
    values, matrix = np.asarray(signal, float), np.asarray(xyz_per_dn, float)

    def spread(variances: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(
            np.einsum("ib,b...,jb->...ij", matrix, variances, matrix, optimize=True), np.float64
        )

    relative = uncertainty.band.reshape(-1, *[1] * (values.ndim - 1))
    xyz = np.tensordot(values, matrix, axes=(0, 1))
    return CovarianceParts(
        spread(np.asarray(variance, float)),
        spread((relative * values) ** 2),
        uncertainty.common**2 * xyz[..., :, None] * xyz[..., None, :],
    )


def band_scatter(constants: tuple[BandConstant, ...]) -> float:
    """Relative standard deviation between the bands' constants C beyond their own noise.

    That is what flats and filter curves do to a band: C itself is one for all. By the moment estimator
    of DerSimonian and Laird (1986); 0 where noise explains the scatter or for a single band.
    """
    if len(constants) < 2:
        return 0.0
    value = np.array([c.constant for c in constants])
    weight = 1 / np.array([c.sigma for c in constants]) ** 2
    mean = np.average(value, weights=weight)
    excess = np.sum(weight * (value - mean) ** 2) - (value.size - 1)
    spread = excess / (weight.sum() - np.sum(weight**2) / weight.sum())
    return float(np.sqrt(max(spread, 0.0)) / mean)


def measure_uncertainty(
    radiometry: Radiometry, bands: tuple[str, ...], reference_relative_sigma: float = 0.0
) -> Uncertainty:
    """What a capture's references show of the two shared kinds.

    band : the scatter between the bands' constants, the same for all bands, joined with each constant's own
    noise where it was measured. common : of the mean constant, joined with reference_relative_sigma, the
    scale of the reference source's spectrum, which the capture format does not state.
    """
    scatter = band_scatter(radiometry.by_band)
    own = {c.band: c.sigma / c.constant for c in radiometry.by_band}
    band = np.array([np.hypot(scatter, own.get(name, 0.0)) for name in bands])
    common = 0.0
    if radiometry.sigma is not None and radiometry.constant is not None:
        common = radiometry.sigma / radiometry.constant
    return Uncertainty(bands, band, float(np.hypot(common, reference_relative_sigma)))
