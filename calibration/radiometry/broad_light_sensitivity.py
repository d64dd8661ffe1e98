"""Spectral sensitivity of a channel from its responses to broad lights.

The lights are the patches of a chart, for instance. The spectra of paints are smooth and alike, so that a few patches
determine a sensitivity only with an assumption. It is a Gaussian process here. With A the stimuli and r the responses,
both in the sense of ``spectral_sensitivity``,

    c = K A^T (A K A^T + N)^-1 r,    K(l, l') = a exp(-(l - l')^2 / (2 w^2)),

the Wiener estimate for the prior covariance K, restricted to c >= 0. The likelihood of the responses chooses the scale
a, the width w and the relative error of the model in N. No value is assumed for them.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from .spectral_sensitivity import NarrowBandReadings

__all__ = ["smooth_wiener"]

#: Widths of the correlation that are tried, nm: peaks of filter arrays are 40 to 120 nm wide.
_WIDTHS_NM = (20.0, 30.0, 40.0, 60.0, 90.0)
#: Scales of the prior that are tried, over the square of a typical sensitivity.
_SCALES = np.logspace(-1.5, 1.5, 13)
#: Relative errors of the model that are tried: of the chart's table, of its light and of the lamp's spectrum.
_MODEL_ERRORS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
#: Error of a response by the model at least, over the largest response: stray light in the darkest patches.
_SMALLEST_ERROR = 0.2
#: Share of the prior's variance that is independent between wavelengths, for a covariance that can be inverted.
_INDEPENDENT = 1e-7


def smooth_wiener(readings: NarrowBandReadings) -> NDArray[np.float64]:
    """Positive Wiener estimate with a smooth prior.

    Parameters
    ----------
    readings
        Responses of one channel to lights of any width.

    Returns
    -------
    NDArray
        (n,) sensitivity on the wavelengths of the readings, DN per W s m^-2 sr^-1.
    """
    nm, matrix, response = readings.wavelength_nm, readings.matrix, readings.response
    typical = (float(response.max()) / float(matrix.sum(axis=1).max())) ** 2
    distance = nm[:, None] - nm
    best, choice = -np.inf, (np.eye(nm.size), readings.sigma)
    for width in _WIDTHS_NM:
        shape = np.exp(-0.5 * (distance / width) ** 2) + _INDEPENDENT * np.eye(nm.size)
        signal = typical * matrix @ shape @ matrix.T
        for scale, error in itertools.product(_SCALES.tolist(), _MODEL_ERRORS):
            by_model = error * np.hypot(response, _SMALLEST_ERROR * float(response.max()))
            sigma = np.hypot(readings.sigma, by_model)
            likelihood = _log_likelihood(scale * signal + np.diag(sigma**2), response)
            if likelihood > best:
                best, choice = likelihood, (scale * typical * shape, sigma)
    covariance, sigma = choice
    size = float(np.sqrt(covariance[0, 0]))
    whitening = solve_triangular(np.linalg.cholesky(covariance / size**2), np.eye(nm.size), lower=True)
    rows = np.vstack([matrix * size / sigma[:, None], whitening])
    right = np.concatenate([response / sigma, np.zeros(nm.size)])
    return nnls(rows, right, maxiter=30 * nm.size)[0] * size


def _log_likelihood(covariance: NDArray[np.float64], response: NDArray[np.float64]) -> float:
    """Logarithm of the normal density of responses with mean 0, without its constant."""
    lower = np.linalg.cholesky(covariance)
    white = solve_triangular(lower, response, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(lower)).sum())
