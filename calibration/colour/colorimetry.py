"""XYZ from band signals by filter weights (Pattanaik et al. 1997).

The colour-matching functions are approximated by sums of the bands' responses F_i = F Q T_lens T_i,

     xbar(l) ~ Sum_i b_i F_i(l)    (eq. 5),    X = 683 lm/W Sum_i b_i S_i / K_i    (eq. 4),

so X, Y, Z are absolute (Y is luminance in cd m^-2) if the calibration factor C is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from ..instrument import LUMINOUS_EFFICACY, BandResponse, Mask, cell_means, colour_matching_functions
from ..radiometry import Uncertainty, xyz_parts

__all__ = [
    "FilterWeights",
    "described",
    "fit_filter_weights",
    "train_filter_weights",
    "xyz_image",
]


@dataclass(frozen=True, eq=False)
class FilterWeights:
    """Filter weights b_i and their quality."""

    #: Identifiers of the bands.
    bands: tuple[str, ...]
    #: Wavelengths of the curves, nm.
    wavelength_nm: NDArray[np.float64]
    #: (3, band) weights, J per quantum, rows X, Y, Z.
    weights: NDArray[np.float64]
    #: (3, wavelength) curves Sum_i b_i F_i.
    reconstructed: NDArray[np.float64]
    #: (3, wavelength) curves to reconstruct: the colour-matching functions.
    target: NDArray[np.float64]
    #: (3,) root mean square of `reconstructed` - `target`.
    residual_rms: NDArray[np.float64]
    #: (3,) relative standard deviation of X, Y, Z for light of equal energy per nm, divided by that of every band's
    #: signal; at least 1 / sqrt(bands).
    noise_gain: NDArray[np.float64]
    #: "least squares", "regularised", "trained" or "perceptual".
    method: str
    #: (band,) relative standard deviation of the signals that was assumed.
    relative_noise: NDArray[np.float64]


def fit_filter_weights(
    responses: Sequence[BandResponse],
    relative_noise: ArrayLike = 0.0,
    target: NDArray[np.float64] | None = None,
) -> FilterWeights:
    """Filter weights by least squares with Tikhonov regularisation; the noise sets its strength.

    The error of X has two parts: the misfit e(l) = xbar - Sum b_i F_i integrated over the light's spectrum, and the
    noise Sum b_i n_i. The spectrum is modelled as L0 times random values of unit variance. They are constant within
    intervals of length D and independent between them, D = range / number of bands (the spectral resolution of the
    bands). The expected square of the misfit part is then L0^2 D Int e^2 dl. That of the noise part is L0^2 Sum b_i^2
    (relative_noise_i Int F_i dl)^2. Their sum is minimised.

    Parameters
    ----------
    responses
        Response of every band, on one grid.
    relative_noise
        Standard deviation over signal of a band (one number, or one per band), for light of equal energy per nm. 0
        gives plain least squares.
    target
        (3, wavelength) curves to reconstruct; None means the CIE 1931 colour-matching functions.

    Returns
    -------
    FilterWeights
        Weights of the method "least squares" or "regularised".
    """
    wavelength = responses[0].wavelength_nm
    goal = colour_matching_functions() if target is None else target
    curves = np.stack([response.response for response in responses])
    noise = np.broadcast_to(np.asarray(relative_noise, float), (len(responses),))
    step = responses[0].grid.weights
    areas = curves @ step
    interval = (wavelength[-1] - wavelength[0]) / len(responses)
    # Responses of unit area: in quanta per joule (1e17) the equations would be badly conditioned.
    unit = curves / areas[:, None]
    rows = np.concatenate([(unit * np.sqrt(interval * step)).T, np.diag(noise)])
    right = np.concatenate([(goal * np.sqrt(interval * step)).T, np.zeros((len(responses), len(goal)))])
    scaled = np.linalg.lstsq(rows, right, rcond=None)[0].T
    method = "regularised" if np.any(noise > 0) else "least squares"
    return described(responses, scaled / areas, goal, method, noise)


def train_filter_weights(
    responses: Sequence[BandResponse], radiances: NDArray[np.float64], relative_noise: ArrayLike
) -> FilterWeights:
    """Filter weights of least mean square relative error of X, Y, Z over radiances.

    With s the signals of a radiance and t its exact X (or Y, Z), both divided by t, b = E[t s^T] (E[s s^T] + noise
    covariance)^-1. This is the linear minimum mean square error estimate without a constant term, so that XYZ is
    proportional to the light (Pratt and Mancill, Applied Optics 15, 1976, for spectra).

    Parameters
    ----------
    responses
        Response of every band, on one grid.
    radiances
        (n, wavelength) radiances, see ``radiance_ensemble``.
    relative_noise
        Standard deviation of a band's signal over its rms in the ensemble (one number or (band,)).

    Returns
    -------
    FilterWeights
        Weights of the method "trained".
    """
    step, goal = responses[0].grid.weights, colour_matching_functions()
    noise = np.broadcast_to(np.asarray(relative_noise, float), (len(responses),))
    signal = radiances @ (step * np.stack([response.response for response in responses])).T
    exact = radiances @ (step * goal).T
    weights = np.empty((3, len(responses)))
    for axis in range(3):
        relative = signal / exact[:, axis : axis + 1]
        scale = np.sqrt(np.mean(relative**2, axis=0))
        # a band without light in the ensemble gets no weight
        scale[scale == 0] = 1.0
        # A ridge far below any noise bounds the weights of bands that are collinear over the ensemble.
        loading = np.sqrt(len(signal)) * np.maximum(noise, 1e-6)
        rows = np.concatenate([relative / scale, np.diag(loading)])
        right = np.concatenate([np.ones(len(signal)), np.zeros(len(responses))])
        weights[axis] = np.linalg.lstsq(rows, right, rcond=None)[0] / scale
    return described(responses, weights, goal, "trained", noise)


def described(
    responses: Sequence[BandResponse],
    weights: NDArray[np.float64],
    goal: NDArray[np.float64],
    method: str,
    noise: NDArray[np.float64],
) -> FilterWeights:
    """Filter weights with the quality of their reconstruction.

    Parameters
    ----------
    responses
        Response of every band, on one grid.
    weights
        (3, band) weights, J per quantum.
    goal
        (3, wavelength) curves to reconstruct.
    method
        Name of the method.
    noise
        (band,) relative standard deviation of the signals that was assumed.

    Returns
    -------
    FilterWeights
        The weights with residual and noise gain.
    """
    curves = np.stack([response.response for response in responses])
    reconstructed = weights @ curves
    scaled = weights * (curves @ responses[0].grid.weights)
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
    """(3, band) X, Y, Z per DN of the bands' signals."""
    return LUMINOUS_EFFICACY * weights.weights / np.array([response.factor for response in responses])


def xyz_image(
    images: xr.Dataset,
    weights: FilterWeights,
    responses: Sequence[BandResponse],
    uncertainty: Uncertainty | None = None,
    relative_error: NDArray[np.float64] | None = None,
    cell: tuple[int, int] | None = None,
) -> xr.Dataset:
    """Tristimulus images of band images.

    With a mosaic, all pixels of a cell get the XYZ of the means of each band's pixels in it, see ``cell_means``.

    Parameters
    ----------
    images
        BandImages (band, y, x) in DN with variance and mask.
    weights
        Filter weights.
    responses
        Response of every band, with its factor K_i.
    uncertainty
        Band and common components of the signals; None leaves out all covariances.
    relative_error
        (n, 3) relative errors of the weights over plausible spectra; None leaves out `covariance_weights`.
    cell
        (height, width) of one repeat of the mosaic, px; None without a mosaic.

    Returns
    -------
    xr.Dataset
        ``xyz`` (component, y, x), Y in cd m^-2; its ``variance`` from the images' independent noise only; ``mask`` (y,
        x), the union of the bands' flags, with a mosaic OTHER_CHANNEL where a band has no used pixel in the cell. With
        an uncertainty also ``covariance_pixel`` and ``covariance_shared`` (y, x, component, component_2): of the noise,
        and of the errors common to all pixels of a band or of all bands. With relative errors also
        ``covariance_weights``: of the approximation of the colour-matching functions, which is the same in pixels of
        the same spectrum.
    """
    matrix = _signal_to_xyz(weights, responses)
    flags = np.bitwise_or.reduce(images["mask"].values, axis=0)
    signal, variance = images["signal"].values, images["variance"].values
    if cell is not None:
        cells = cell_means(signal, variance, images["mask"].values == 0, cell)
        signal, variance = cells.signal, cells.variance
        flags = np.where(cells.complete, np.uint8(0), np.uint8(Mask.OTHER_CHANNEL))
    dims, units = ("component", "y", "x"), {"units": "cd^2 m^-4"}
    result = xr.Dataset(
        {
            "xyz": (dims, np.tensordot(matrix, signal, 1), {"units": "cd m^-2 (Y)"}),
            "variance": (dims, np.tensordot(matrix**2, variance, 1), units),
            "mask": (("y", "x"), flags, dict(images["mask"].attrs)),
        },
        coords={"component": ["X", "Y", "Z"]},
    )
    if uncertainty is None:
        return result
    parts = xyz_parts(signal, variance, matrix, uncertainty)
    both = ("y", "x", "component", "component_2")
    result = result.assign(
        covariance_pixel=(both, parts.pixel, units),
        covariance_shared=(both, parts.band + parts.common, units),
    ).assign_coords(component_2=["X", "Y", "Z"])
    if relative_error is None:
        return result
    value = np.moveaxis(result["xyz"].values, 0, -1)
    approximation = (
        value[..., :, None] * value[..., None, :] * (relative_error.T @ relative_error / len(relative_error))
    )
    return result.assign(covariance_weights=(both, approximation, units))
