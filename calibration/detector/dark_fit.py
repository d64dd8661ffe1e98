"""Dark level against exposure time: a straight-line fit, its residuals, and a test for a trend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2
from scipy.stats import t as student

from ..correction import DarkLibrary, NoiseModel, hot_pixels

__all__ = ["DarkFit", "dark_level_sigma", "fit_dark", "measure_dark_fit", "ordinary_pixels"]

_IMPROBABLE = 1e-2


@dataclass(frozen=True, eq=False)
class DarkFit:
    """level = bias + rate * exposure by least squares over n >= 3 exposures.

    exposure_s, level_dn, residual_dn : (n,). All exposures have equal weight, since curvature of the level is not
    noise. bias_dn, rate_dn_s : with one sigma from noise and from excess scatter about the line. degrees : degrees
    of freedom of the sigmas, infinite if noise explains the scatter.
    rms_dn : of the residual. monotonic : the levels never fall with time. verdict : one sentence.
    """

    exposure_s: NDArray[np.float64]
    level_dn: NDArray[np.float64]
    bias_dn: float
    bias_sigma: float
    rate_dn_s: float
    rate_sigma: float
    residual_dn: NDArray[np.float64]
    rms_dn: float
    degrees: float
    monotonic: bool
    verdict: str


def fit_dark(exposure_s: ArrayLike, level_dn: ArrayLike, noise_dn: ArrayLike = 0.0) -> DarkFit:
    """Fit levels (n,) in DN to exposures (n,) in s. noise_dn : standard deviation by noise, scalar or (n,).

    Raises ValueError for fewer than three exposures.
    """
    time, level = np.asarray(exposure_s, float), np.asarray(level_dn, float)
    if np.unique(time).size < 3:
        raise ValueError("a dark fit needs at least three exposures")
    order = np.argsort(time)
    noise = np.broadcast_to(np.asarray(noise_dn, float), time.shape)[order]
    time, level = time[order], level[order]
    design = np.stack([np.ones_like(time), time], axis=1)
    lever = np.linalg.inv(design.T @ design) @ design.T
    line = lever @ level
    residual = level - design @ line
    freedom = time.size - 2
    left = 1 - np.einsum("ni,in->n", design, lever)
    misfit = float(np.sum(residual**2) / np.sum(left * noise**2)) if np.any(noise > 0) else np.inf
    # Excess scatter is added only if it is significant.
    beyond = chi2.sf(misfit * freedom, freedom) < _IMPROBABLE
    excess = float(np.sum(residual**2) - np.sum(left * noise**2)) / freedom if beyond else 0.0
    known, estimated = lever**2 @ noise**2, lever**2 @ np.full(time.size, excess)
    sigma = np.sqrt(known + estimated)
    degrees = freedom if excess > 0 else np.inf
    falls = np.diff(level) < -3 * np.hypot(noise[1:], noise[:-1])
    return DarkFit(
        time,
        level,
        float(line[0]),
        float(sigma[0]),
        float(line[1]),
        float(sigma[1]),
        residual,
        float(np.sqrt(np.mean(residual**2))),
        degrees,
        not bool(np.any(falls)),
        _verdict(time, line[1], sigma[1], residual, falls, degrees),
    )


def _verdict(
    time: NDArray[np.float64],
    rate: float,
    sigma: float,
    residual: NDArray[np.float64],
    falls: NDArray[np.bool_],
    freedom: float,
) -> str:
    chance = 2 * float(student.sf(abs(rate) / sigma, freedom)) if sigma > 0 else 0.0
    if chance > _IMPROBABLE:
        text = "no trend with exposure time"
    else:
        text = f"{'rises' if rate > 0 else 'falls'} by {abs(rate):.3g} DN/s"
    worst = int(np.argmax(np.abs(residual)))
    text += f"; the largest residual is {residual[worst]:+.3g} DN, at {time[worst]:g} s"
    if np.any(falls) and not np.all(falls):
        first = int(np.argmax(falls))
        text += f"; not monotonic: it falls from {time[first]:g} to {time[first + 1]:g} s"
    return text


def dark_level_sigma(dark: DarkLibrary, noise: NoiseModel) -> NDArray[np.float64]:
    """(k,) standard deviation by noise of the mean of each dark level over all pixels, DN."""
    variance = [noise.variance(dark.thermal(float(time))).mean() for time in dark.exposure_s]
    return np.sqrt(np.array(variance) / (dark.repeats * dark.bias.size))


def ordinary_pixels(dark: DarkLibrary, noise: NoiseModel) -> NDArray[np.bool_]:
    """(y, x) False for pixels that are hot at the longest exposure: they saturate, and their level is not linear."""
    smallest = float(np.sqrt(noise.floor_dn2 / dark.repeats.max()))
    return ~hot_pixels(dark.level[-1], smallest)


def measure_dark_fit(dark: DarkLibrary, noise: NoiseModel) -> DarkFit | None:
    """The fit over a capture's dark levels (means of ordinary pixels); None for fewer than three exposures."""
    if dark.exposure_s.size < 3:
        return None
    levels = dark.level[:, ordinary_pixels(dark, noise)].mean(axis=1)
    return fit_dark(dark.exposure_s, levels, dark_level_sigma(dark, noise))
