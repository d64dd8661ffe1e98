"""Dark level against exposure time: straight-line fit, residuals, test for a trend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import chi2_tail, student_tail
from numpy.typing import ArrayLike, NDArray

from ..correction import DarkLibrary, NoiseModel, hot_pixels

__all__ = ["DarkFit", "dark_level_sigma", "fit_dark", "measure_dark_fit", "ordinary_pixels"]

#: Probability below which a trend or an excess scatter is significant.
_SIGNIFICANCE = 1e-2


@dataclass(frozen=True, eq=False)
class DarkFit:
    """Dark levels of n >= 3 exposures and the line level = bias + rate * exposure through them.

    All exposures have equal weight, since curvature of the level is not noise. A sigma is one standard deviation by
    noise and by significant excess scatter about the line.
    """

    #: (n,) exposure times, ascending, s.
    exposure_s: NDArray[np.float64]
    #: (n,) mean dark levels, DN.
    level_dn: NDArray[np.float64]
    #: Level at zero exposure, DN.
    bias_dn: float
    #: Standard deviation of the bias, DN.
    bias_sigma: float
    #: Slope, DN/s.
    rate_dn_s: float
    #: Standard deviation of the slope, DN/s.
    rate_sigma: float
    #: (n,) level minus line, DN.
    residual_dn: NDArray[np.float64]
    #: Root mean square of the residuals, DN.
    rms_dn: float
    #: Degrees of freedom of the sigmas; infinite if noise explains the scatter.
    degrees: float
    #: True if no level falls with time by more than three standard deviations of its noise.
    monotonic: bool
    #: Trend, largest residual and falls, one sentence.
    verdict: str


def fit_dark(exposure_s: ArrayLike, level_dn: ArrayLike, noise_dn: ArrayLike = 0.0) -> DarkFit:
    """Fit a straight line to dark levels over exposure time.

    Parameters
    ----------
    exposure_s
        (n,) exposure times, s, in any order.
    level_dn
        (n,) dark levels, DN.
    noise_dn
        Standard deviation of the levels by noise, scalar or (n,), DN.

    Returns
    -------
    DarkFit
        The exposures sorted.

    Raises
    ------
    ValueError
        For fewer than three different exposures.
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
    leverage_complement = 1 - np.einsum("ni,in->n", design, lever)
    misfit = float(np.sum(residual**2) / np.sum(leverage_complement * noise**2)) if np.any(noise > 0) else np.inf
    # Excess scatter is added only if it is significant.
    beyond = chi2_tail(misfit * freedom, freedom) < _SIGNIFICANCE
    excess = float(np.sum(residual**2) - np.sum(leverage_complement * noise**2)) / freedom if beyond else 0.0
    noise_part, scatter_part = lever**2 @ noise**2, lever**2 @ np.full(time.size, excess)
    sigma = np.sqrt(noise_part + scatter_part)
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
    """One sentence: the trend, the largest residual, and where the level falls."""
    chance = 2 * float(student_tail(abs(rate) / sigma, freedom)) if sigma > 0 else 0.0
    if chance > _SIGNIFICANCE:
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
    """Standard deviation by noise of the mean of each dark level over all pixels.

    Parameters
    ----------
    dark
        The dark levels.
    noise
        Noise model of one count.

    Returns
    -------
    NDArray
        (k,) standard deviations, DN.
    """
    variance = [noise.variance(dark.thermal(float(time))).mean() for time in dark.exposure_s]
    return np.sqrt(np.array(variance) / (dark.repeats * dark.bias.size))


def ordinary_pixels(dark: DarkLibrary, noise: NoiseModel) -> NDArray[np.bool_]:
    """Pixels that are not hot at the longest exposure; the level of hot ones is not linear.

    Parameters
    ----------
    dark
        The dark levels; at least one.
    noise
        Noise model of one count; its floor bounds the spread of the levels from below.

    Returns
    -------
    NDArray
        (y, x) True for ordinary pixels.
    """
    smallest = float(np.sqrt(noise.floor_dn2 / dark.repeats.max()))
    return ~hot_pixels(dark.level[-1], smallest)


def measure_dark_fit(dark: DarkLibrary, noise: NoiseModel) -> DarkFit | None:
    """Fit the mean dark level of the ordinary pixels over exposure time.

    Parameters
    ----------
    dark
        The dark levels.
    noise
        Noise model of one count.

    Returns
    -------
    DarkFit | None
        None for fewer than three exposures.
    """
    if dark.exposure_s.size < 3:
        return None
    levels = dark.level[:, ordinary_pixels(dark, noise)].mean(axis=1)
    return fit_dark(dark.exposure_s, levels, dark_level_sigma(dark, noise))
