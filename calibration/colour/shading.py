"""Uneven illumination of a chart, from the gradients within its patches.

A patch has a uniform reflectance, so the logarithm of its signal is a constant plus the logarithm of the smooth
illumination:

    log S(u, v) = a_patch + Sum_jk c_jk x^j y^k

Subtracting each patch's mean from both sides removes a_patch. The rest determines the relative illumination in the
plane of the chart, without a second surface and without any known reflectance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

__all__ = ["ORDERS", "PatchPixels", "Shading", "fit_shading"]

#: Polynomial orders; cross-validation chooses one.
ORDERS = (2, 3)

#: Smallest signal-to-noise ratio of a pixel at which the bias of the logarithm is negligible.
_LOWEST_SNR = 8.0


@dataclass(frozen=True, eq=False)
class PatchPixels:
    """Usable pixels of one patch."""

    #: (n,) columns, px.
    u_px: NDArray[np.float64]
    #: (n,) rows, px.
    v_px: NDArray[np.float64]
    #: (n,) signals, DN.
    signal: NDArray[np.float64]
    #: Standard deviation of the signal of one pixel, DN.
    sigma: float


@dataclass(frozen=True, eq=False)
class Shading(FrozenMappings):
    """Relative illumination exp(Sum c_jk x^j y^k), j + k from 1 to `order`, 1 at `centre_px`."""

    #: Order of the polynomial.
    order: int
    #: (terms,) coefficients c_jk.
    coefficients: NDArray[np.float64]
    #: (terms, terms) of the coefficients, by the jackknife over patches, which includes unevenness within patches.
    covariance: NDArray[np.float64]
    #: Degrees of freedom of `covariance`, for Student's t.
    degrees: int
    #: Position (u, v) of the origin of x and y, px.
    centre_px: tuple[float, float]
    #: Length of the unit of x and y, px.
    scale_px: float
    #: By order, weighted mean square of the residuals in patches held out of the fit.
    validation: Mapping[int, float]

    def _basis(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        return _basis(u_px, v_px, self.order, self.centre_px, self.scale_px)

    def at(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """Relative illumination at pixel positions.

        Parameters
        ----------
        u_px, v_px
            (...) positions, px.

        Returns
        -------
        NDArray
            (...) illumination over that at `centre_px`.
        """
        return np.exp(self._basis(u_px, v_px) @ self.coefficients)

    def relative_sigma(
        self, u_px: ArrayLike, v_px: ArrayLike, reference_px: tuple[float, float]
    ) -> NDArray[np.float64]:
        """Relative standard deviation of the illumination's ratio to that at a reference position.

        Parameters
        ----------
        u_px, v_px
            (...) positions, px.
        reference_px
            Reference position (u, v), px.

        Returns
        -------
        NDArray
            (...) relative standard deviation.
        """
        difference = self._basis(u_px, v_px) - self._basis(*reference_px)
        return np.sqrt(np.einsum("...i,ij,...j->...", difference, self.covariance, difference))


def _basis(
    u_px: ArrayLike, v_px: ArrayLike, order: int, centre: tuple[float, float], scale: float
) -> NDArray[np.float64]:
    """(..., terms) monomials x^j y^k, j + k from 1 to ``order``."""
    x, y = (np.asarray(u_px, float) - centre[0]) / scale, (np.asarray(v_px, float) - centre[1]) / scale
    powers = [(j, total - j) for total in range(1, order + 1) for j in range(total + 1)]
    return np.stack([x**j * y**k for j, k in powers], axis=-1)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of one patch."""

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    constant: float
    weight: float


def _equations(patch: PatchPixels, basis: NDArray[np.float64]) -> _Equations:
    # One weight per patch, from its mean: weights from single pixels would be correlated with their noise.
    """Normal equations of a patch whose mean logarithm is removed."""
    weight = float((patch.signal.mean() / patch.sigma) ** 2)
    logarithm = np.log(np.maximum(patch.signal, patch.sigma))
    logarithm = logarithm - logarithm.mean()
    basis = basis - basis.mean(axis=0)
    return _Equations(
        weight * basis.T @ basis,
        weight * basis.T @ logarithm,
        weight * float(logarithm @ logarithm),
        weight * logarithm.size,
    )


def fit_shading(patches: Sequence[PatchPixels], orders: Sequence[int] = ORDERS) -> Shading | None:
    """Illumination over the patches.

    Patches with a mean below eight standard deviations of a pixel, or of ten pixels or fewer, are not used. The order
    is chosen by leave-one-patch-out cross-validation.

    Parameters
    ----------
    patches
        Pixels of the patches.
    orders
        Polynomial orders to choose from.

    Returns
    -------
    Shading | None
        Illumination; None if fewer than four patches are bright enough.
    """
    bright = [p for p in patches if p.signal.size > 10 and p.signal.mean() > _LOWEST_SNR * p.sigma]
    if len(bright) < 4:
        return None
    every_u, every_v = (np.concatenate([getattr(p, axis) for p in bright]) for axis in ("u_px", "v_px"))
    centre = (float(every_u.mean()), float(every_v.mean()))
    scale = float(max(np.ptp(every_u), np.ptp(every_v)) / 2)
    validation: dict[int, float] = {}
    fits: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for order in orders:
        parts = [_equations(p, _basis(p.u_px, p.v_px, order, centre, scale)) for p in bright]
        normal = np.sum([e.normal for e in parts], axis=0)
        right = np.sum([e.right for e in parts], axis=0)
        error, without = 0.0, []
        for part in parts:
            fit = np.linalg.lstsq(normal - part.normal, right - part.right, rcond=None)[0]
            error += part.constant - 2 * fit @ part.right + fit @ part.normal @ fit
            without.append(fit)
        validation[order] = float(error / sum(e.weight for e in parts))
        spread = np.stack(without) - np.mean(without, axis=0)
        jackknife: NDArray[np.float64] = (len(parts) - 1) / len(parts) * spread.T @ spread
        fits[order] = (np.asarray(np.linalg.solve(normal, right), np.float64), jackknife)
    order = min(validation, key=lambda o: validation[o])
    return Shading(order, *fits[order], len(bright) - 1, centre, scale, validation)
