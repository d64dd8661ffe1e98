"""XYZ from band signals: filter weights b_i and the tristimulus values they give (Pattanaik et al. 1997).

The colour-matching functions are written as sums of the bands' own responses F_i = F Q T_lens T_i,

    xbar(l) ~ Sum_i b_i F_i(l)    (eq. 5),    X = 683 lm/W Sum_i b_i S_i / K_i    (eq. 4),

so X, Y, Z are absolute (Y is luminance in cd m^-2) where C is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from .sensor_equation import WAVELENGTH_NM, BandResponse, trapezoidal_weights
from .uncertainty import Uncertainty, xyz_parts

__all__ = [
    "LUMINOUS_EFFICACY", "FilterWeights", "colour_matching_functions", "fit_filter_weights",
    "train_filter_weights", "xyz_covariance", "xyz_image",
]  # fmt: skip

#: lm/W, of monochromatic light at 555 nm.
LUMINOUS_EFFICACY = 683.0


def colour_matching_functions() -> NDArray[np.float64]:
    """(3, 301) CIE 1931 2-degree xbar, ybar, zbar on WAVELENGTH_NM (tables of colour-science)."""
    from colour import MSDS_CMFS  # slow to import, and only needed here

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    table = np.asarray(observer.values, float).T
    return np.stack([np.interp(WAVELENGTH_NM, observer.wavelengths, row) for row in table])


@dataclass(frozen=True, eq=False)
class FilterWeights:
    """b_i and how well they do.

    weights : (3, band), J per quantum: rows X, Y, Z. reconstructed : (3, wavelength), their sums.
    target : (3, wavelength), the colour-matching functions. residual_rms : (3,) of reconstructed - target.
    noise_gain : (3,) relative standard deviation of X, Y, Z for light of equal energy per nm, over the
        relative standard deviation of every band's signal; 1 / sqrt(bands) is as quiet as it can be.
    method : "least squares", "regularised" or "trained". relative_noise : (band,) the level it was told.
    """

    bands: tuple[str, ...]
    wavelength_nm: NDArray[np.float64]
    weights: NDArray[np.float64]
    reconstructed: NDArray[np.float64]
    target: NDArray[np.float64]
    residual_rms: NDArray[np.float64]
    noise_gain: NDArray[np.float64]
    method: str
    relative_noise: NDArray[np.float64]


def fit_filter_weights(
    responses: Sequence[BandResponse],
    relative_noise: ArrayLike = 0.0,
    target: NDArray[np.float64] | None = None,
) -> FilterWeights:
    """Filter weights by least squares, regularised as far as the stated noise asks for.

    relative_noise : standard deviation over signal of a band (one number, or one per band), for light of
        equal energy per nm. 0 gives plain least squares. target : (3, wavelength), default CIE 1931.

    The error of X has two parts: the misfit e(l) = xbar - Sum b_i F_i integrated over the light's spectrum,
    and the noise Sum b_i n_i. Taking the spectrum as L0 times values of unit variance that are independent
    from one stretch of length D to the next, D = range / number of bands (all that so many bands can tell
    apart), the expected square of the first is L0^2 D Int e^2 dl; that of the second is
    L0^2 Sum b_i^2 (relative_noise_i Int F_i dl)^2. Their sum is minimised: Tikhonov regularisation whose
    strength is fixed by the noise and not by taste.
    """
    wavelength = responses[0].wavelength_nm
    goal = colour_matching_functions() if target is None else target
    curves = np.stack([response.response for response in responses])
    noise = np.broadcast_to(np.asarray(relative_noise, float), (len(responses),))
    areas = curves @ trapezoidal_weights(wavelength)
    step = trapezoidal_weights(wavelength)
    stretch = (wavelength[-1] - wavelength[0]) / len(responses)
    # In units of quanta per joule (1e17) the equations would be badly conditioned.
    unit = curves / areas[:, None]
    rows = np.concatenate([(unit * np.sqrt(stretch * step)).T, np.diag(noise)])
    right = np.concatenate([(goal * np.sqrt(stretch * step)).T, np.zeros((len(responses), len(goal)))])
    scaled = np.linalg.lstsq(rows, right, rcond=None)[0].T
    method = "regularised" if np.any(noise > 0) else "least squares"
    return _described(responses, scaled / areas, goal, method, noise)


def train_filter_weights(
    responses: Sequence[BandResponse], radiances: NDArray[np.float64], relative_noise: ArrayLike
) -> FilterWeights:
    """Filter weights with the least expected square of the relative errors of X, Y, Z over an ensemble.

    radiances : (n, wavelength), see ``radiance_ensemble``. relative_noise : standard deviation of a band's
    signal over its rms in the ensemble (one number or (band,)).

    With s the signals of a radiance and t its exact X (or Y, or Z), both divided by t,
    b = E[t s^T] (E[s s^T] + noise covariance)^-1: linear minimum mean square error without a constant term,
    so that twice the light has twice the XYZ (Pratt and Mancill, Applied Optics 15, 1976, for spectra).
    """
    step, goal = trapezoidal_weights(responses[0].wavelength_nm), colour_matching_functions()
    noise = np.broadcast_to(np.asarray(relative_noise, float), (len(responses),))
    signal = radiances @ (step * np.stack([response.response for response in responses])).T
    exact = radiances @ (step * goal).T
    weights = np.empty((3, len(responses)))
    for axis in range(3):
        relative = signal / exact[:, axis : axis + 1]
        scale = np.sqrt(np.mean(relative**2, axis=0))
        # A ridge far below any noise keeps bands that the ensemble cannot tell apart from blowing up.
        loading = np.sqrt(len(signal)) * np.maximum(noise, 1e-6)
        rows = np.concatenate([relative / scale, np.diag(loading)])
        right = np.concatenate([np.ones(len(signal)), np.zeros(len(responses))])
        weights[axis] = np.linalg.lstsq(rows, right, rcond=None)[0] / scale
    return _described(responses, weights, goal, "trained", noise)


def _described(
    responses: Sequence[BandResponse], weights: NDArray[np.float64], goal: NDArray[np.float64],
    method: str, noise: NDArray[np.float64],
) -> FilterWeights:  # fmt: skip
    curves = np.stack([response.response for response in responses])
    reconstructed = weights @ curves
    scaled = weights * (curves @ trapezoidal_weights(responses[0].wavelength_nm))
    return FilterWeights(
        bands=tuple(response.band for response in responses),
        wavelength_nm=responses[0].wavelength_nm,
        weights=weights,
        reconstructed=reconstructed,
        target=goal,
        residual_rms=np.sqrt(np.mean((reconstructed - goal) ** 2, axis=1)),
        noise_gain=np.sqrt(np.sum(scaled**2, axis=1)) / np.abs(scaled.sum(axis=1)),
        method=method,
        relative_noise=noise.copy(),
    )


def _signal_to_xyz(weights: FilterWeights, responses: Sequence[BandResponse]) -> NDArray[np.float64]:
    return LUMINOUS_EFFICACY * weights.weights / np.array([response.factor for response in responses])


def xyz_image(
    images: xr.Dataset,
    weights: FilterWeights,
    responses: Sequence[BandResponse],
    uncertainty: Uncertainty | None = None,
    relative_error: NDArray[np.float64] | None = None,
) -> xr.Dataset:
    """Tristimulus images of BandImages (band, y, x).

    Returns ``xyz`` (component, y, x), Y in cd m^-2, ``variance`` of the same shape by the images' own
    independent noise, and ``mask`` (y, x), the union of the bands' flags. Noise only: the error of the
    weights against the CIE functions and that of C stand apart. With an uncertainty also ``covariance_pixel``
    and ``covariance_shared`` (y, x, component, component_2): the noise, and what bands and all bands share. With
    the relative errors (n, 3) of the weights over plausible spectra also ``covariance_weights``: what the bands do
    not see, alike in pixels of one spectrum.
    """
    matrix = _signal_to_xyz(weights, responses)
    flags = np.bitwise_or.reduce(images["mask"].values, axis=0)
    signal, variance = images["signal"].values, images["variance"].values
    dims, units = ("component", "y", "x"), {"units": "cd^2 m^-4"}
    found = xr.Dataset(
        {
            "xyz": (dims, np.tensordot(matrix, signal, 1), {"units": "cd m^-2 (Y)"}),
            "variance": (dims, np.tensordot(matrix**2, variance, 1), units),
            "mask": (("y", "x"), flags, dict(images["mask"].attrs)),
        },
        coords={"component": ["X", "Y", "Z"]},
    )
    if uncertainty is None:
        return found
    parts = xyz_parts(signal, variance, matrix, uncertainty)
    both = ("y", "x", "component", "component_2")
    found = found.assign(
        covariance_pixel=(both, parts.pixel, units),
        covariance_shared=(both, parts.band + parts.common, units),
    ).assign_coords(component_2=["X", "Y", "Z"])
    if relative_error is None:
        return found
    value = np.moveaxis(found["xyz"].values, 0, -1)
    unseen = (
        value[..., :, None] * value[..., None, :] * (relative_error.T @ relative_error / len(relative_error))
    )
    return found.assign(covariance_weights=(both, unseen, units))


def xyz_covariance(
    variance: ArrayLike, weights: FilterWeights, responses: Sequence[BandResponse]
) -> NDArray[np.float64]:
    """Covariance (..., 3, 3) of X, Y, Z for independent band variances (band, ...) in DN^2."""
    matrix = _signal_to_xyz(weights, responses)
    return np.einsum("ib,b...,jb->...ij", matrix, np.asarray(variance, float), matrix, optimize=True)
