"""Spectral sensitivities of a camera from its responses to narrow-band lights.

With s_i the i-th light times its exposure, c the sensitivity and r_i the response, linearised and above dark,

    r_i = Sum_j c(l_j) s_i(l_j) Dl + n_i        (Vora, Farrell, Tietz, Brainard 2001, eq. 3 with F undone)

is underdetermined, so each estimate also assumes that sensitivities are smooth and not negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.wavelength_grid import trapezoidal_weights
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.optimize import nnls

__all__ = ["NarrowBandReadings", "band_constant", "convex_sets", "least_squares", "wiener"]


@dataclass(frozen=True, eq=False)
class NarrowBandReadings:
    """Responses of one channel to narrow-band lights.

    Raises
    ------
    InputError
        For shapes that do not fit, wavelengths that do not ascend, a stimulus that is negative or 0 everywhere, and a
        sigma that is not above 0.
    """

    #: (n,) ascending wavelengths, nm.
    wavelength_nm: NDArray[np.float64]
    #: (k, n) radiance of the lights times exposure, 0 or more, W s m^-2 sr^-1 nm^-1.
    stimuli: NDArray[np.float64]
    #: (k,) linearised responses above dark, DN.
    response: NDArray[np.float64]
    #: (k,) standard deviations of the responses, above 0, DN.
    sigma: NDArray[np.float64]

    def __post_init__(self) -> None:
        count, width = len(self.response), len(self.wavelength_nm)
        if self.stimuli.shape != (count, width) or self.sigma.shape != (count,) or count < 2 or width < 3:
            fault = f"stimuli of shape {self.stimuli.shape} for {count} readings, {width} wavelengths"
            raise InputError("readings", fault, "(readings, wavelengths), at least two readings, one sigma each")
        if np.any(np.diff(self.wavelength_nm) <= 0):
            raise InputError("readings: wavelength", "values that do not ascend", "ascending wavelengths, nm")
        if np.any(self.stimuli < 0) or np.any(self.matrix.sum(axis=1) <= 0) or np.any(self.sigma <= 0):
            fault = "a stimulus that is negative or 0 everywhere, or a sigma that is not above 0"
            raise InputError("readings", fault, "stimuli of 0 or more with light in each, sigmas above 0")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(k, n) matrix A with A c = r."""
        return self.stimuli * trapezoidal_weights(self.wavelength_nm)

    def predicted(self, sensitivity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Responses of a sensitivity to the lights.

        Parameters
        ----------
        sensitivity
            (n,) sensitivity on `wavelength_nm`, DN per W s m^-2 sr^-1.

        Returns
        -------
        NDArray
            (k,) responses, DN.
        """
        return self.matrix @ sensitivity


def band_constant(readings: NarrowBandReadings) -> NDArray[np.float64]:
    """Sensitivity assumed constant over each light's band.

    It is the response over the light's integral, at the light's centroid. Linear between centroids,
    constant beyond; negative responses are set to 0.

    Parameters
    ----------
    readings
        Responses to the lights.

    Returns
    -------
    NDArray
        (n,) sensitivity on the wavelengths of the readings, DN per W s m^-2 sr^-1.
    """
    area = readings.matrix.sum(axis=1)
    centroid = readings.matrix @ readings.wavelength_nm / area
    order = np.argsort(centroid)
    constant = np.maximum(readings.response / area, 0.0)
    return np.interp(readings.wavelength_nm, centroid[order], constant[order])


def wiener(readings: NarrowBandReadings, noise_share: float = 0.02) -> NDArray[np.float64]:
    """Positive Wiener estimate: the most probable sensitivity c >= 0 with a Gaussian prior.

    Prior mean: ``band_constant``. Prior covariance: first-order Gauss-Markov, with the variance and the correlation of
    neighbours of that mean. The paper does not state how estimates are made positive. Here the quadratic form whose
    minimum is the Wiener estimate is minimised over c >= 0, which gives the same result if the estimate is positive.

    Parameters
    ----------
    readings
        Responses to the lights.
    noise_share
        Variance of the noise, DN^2, over the largest response, DN.

    Returns
    -------
    NDArray
        (n,) sensitivity on the wavelengths of the readings, DN per W s m^-2 sr^-1.
    """
    mean = band_constant(readings)
    variance = float(mean.var())
    if variance == 0:
        return mean
    # a correlation of 1 would make the covariance singular
    correlation = float(np.clip(np.corrcoef(mean[:-1], mean[1:])[0, 1], 0.0, 1 - 1e-6))
    # Gauss-Markov: (c_j - rho c_j-1) are independent, with variance v (1 - rho^2); the first has v
    whitening = np.eye(mean.size) - correlation * np.eye(mean.size, k=-1)
    whitening[1:] /= np.sqrt(1 - correlation**2)
    whitening /= np.sqrt(variance)
    noise = np.sqrt(noise_share * max(float(readings.response.max()), np.finfo(float).tiny))
    return _not_negative(
        np.vstack([readings.matrix / noise, whitening]),
        np.concatenate([readings.response / noise, whitening @ mean]),
    )


def least_squares(readings: NarrowBandReadings) -> NDArray[np.float64]:
    """Smoothest sensitivity c >= 0 consistent with the responses.

    Minimises |(A c - r) / sigma|^2 + w |c''|^2 with the largest w for which the first term is at most the number of
    responses k (discrepancy principle); if even w = 0 fits worse, w is negligible.

    Parameters
    ----------
    readings
        Responses to the lights.

    Returns
    -------
    NDArray
        (n,) sensitivity on the wavelengths of the readings, DN per W s m^-2 sr^-1.
    """
    matrix = readings.matrix / readings.sigma[:, None]
    right = readings.response / readings.sigma
    curvature = _curvature(readings.wavelength_nm)
    unit = np.linalg.norm(matrix) / np.linalg.norm(curvature)

    def fit(exponent: float) -> tuple[NDArray[np.float64], float]:
        rows = np.vstack([matrix, unit * 10.0**exponent * curvature])
        sensitivity = _not_negative(rows, np.concatenate([right, np.zeros(len(curvature))]))
        return sensitivity, float(np.sum((matrix @ sensitivity - right) ** 2))

    low, high = -5.0, 3.0
    best, _ = fit(low)
    for _ in range(18):
        middle = (low + high) / 2
        candidate, misfit = fit(middle)
        if misfit <= right.size:
            low, best = middle, candidate
        else:
            high = middle
    return best


def convex_sets(
    readings: NarrowBandReadings, sigmas: float = 2.0, rounds: int = 500
) -> tuple[NDArray[np.float64], bool]:
    """Sensitivity in the intersection of convex sets, by cyclic projection.

    Sets: every response within ``sigmas`` standard deviations; a curvature of at most that of ``band_constant``; c >= 0
    (after H. J. Trussell and M. R. Civanlar, IEEE Trans. ASSP 32(2), 1984).

    Parameters
    ----------
    readings
        Responses to the lights.
    sigmas
        Allowed deviation of every response, standard deviations.
    rounds
        Cycles of projections at most.

    Returns
    -------
    NDArray
        (n,) sensitivity on the wavelengths of the readings, DN per W s m^-2 sr^-1.
    bool
        Whether the intersection was reached.
    """
    matrix, slack = readings.matrix, sigmas * readings.sigma
    norm = np.sum(matrix**2, axis=1)
    curvature = _curvature(readings.wavelength_nm)
    estimate = band_constant(readings)
    bound = float(np.linalg.norm(curvature @ estimate))
    values, vectors = np.linalg.eigh(curvature.T @ curvature)
    for _ in range(rounds):
        for row, response, allowed, length in zip(matrix, readings.response, slack, norm, strict=True):
            miss = float(row @ estimate - response)
            excess = miss - np.clip(miss, -allowed, allowed)
            estimate = estimate - row * (excess / length)
        estimate = np.maximum(_smoothed(estimate, values, vectors, bound), 0.0)
        misses = np.abs(matrix @ estimate - readings.response) <= slack * (1 + 1e-6)
        if misses.all() and np.linalg.norm(curvature @ estimate) <= bound * (1 + 1e-6):
            return estimate, True
    return estimate, False


def _smoothed(
    estimate: NDArray[np.float64], values: NDArray[np.float64], vectors: NDArray[np.float64], bound: float
) -> NDArray[np.float64]:
    """Closest point of curvature at most ``bound``; values, vectors: eigensystem of D^T D."""
    parts = vectors.T @ estimate

    def size(weight: float) -> float:
        return float(np.sqrt(np.sum(np.maximum(values, 0) * (parts / (1 + weight * values)) ** 2)))

    if size(0.0) <= bound:
        return estimate
    low, high = 0.0, 1.0 / values[-1]
    while size(high) > bound:
        low, high = high, high * 4
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if size(middle) > bound else (low, middle)
    return vectors @ (parts / (1 + high * np.maximum(values, 0)))


def _curvature(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n - 2, n) second differences D in units of the mean step, also for uneven grids."""
    step = np.diff(wavelength_nm) / np.diff(wavelength_nm).mean()
    rows = np.zeros((step.size - 1, wavelength_nm.size))
    index = np.arange(step.size - 1)
    width = (step[:-1] + step[1:]) / 2
    rows[index, index] = 1 / (step[:-1] * width)
    rows[index, index + 2] = 1 / (step[1:] * width)
    rows[index, index + 1] = -rows[index, index] - rows[index, index + 2]
    return rows


def _not_negative(rows: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vector c >= 0 that minimises |rows c - right|."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    return nnls(rows / scale, right, maxiter=30 * rows.shape[1])[0] / scale
