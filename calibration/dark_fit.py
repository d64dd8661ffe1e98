"""Dark level against exposure time: a straight line, what it leaves, and whether the level goes up at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t as student

from .dark import DarkLibrary

__all__ = ["DarkFit", "fit_dark", "measure_dark_fit"]

_IMPROBABLE = 1e-2


@dataclass(frozen=True, eq=False)
class DarkFit:
    """level = bias + rate * exposure by least squares over n >= 3 exposures.

    exposure_s, level_dn, residual_dn : (n,). bias_dn, rate_dn_s with one sigma from the scatter about the
    line (n - 2 degrees of freedom), which holds what noise does not explain: no exposure counts more.
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
    monotonic: bool
    verdict: str


def fit_dark(exposure_s: ArrayLike, level_dn: ArrayLike, noise_dn: float = 0.0) -> DarkFit:
    """Fit the levels (n,) of exposures (n,). noise_dn : standard deviation of a level by noise alone.

    Raises ValueError for fewer than three exposures.
    """
    time, level = np.asarray(exposure_s, float), np.asarray(level_dn, float)
    if np.unique(time).size < 3:
        raise ValueError("a dark fit needs at least three exposures")
    order = np.argsort(time)
    time, level = time[order], level[order]
    design = np.stack([np.ones_like(time), time], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    line = inverse @ design.T @ level
    residual = level - design @ line
    freedom = time.size - 2
    scatter = max(float(np.sum(residual**2) / freedom), noise_dn**2)
    sigma = np.sqrt(scatter * np.diag(inverse))
    falls = np.diff(level) < -3 * np.sqrt(2) * noise_dn
    return DarkFit(
        time, level, float(line[0]), float(sigma[0]), float(line[1]), float(sigma[1]), residual,
        float(np.sqrt(np.mean(residual**2))), not bool(np.any(falls)),
        _verdict(time, line[1], sigma[1], residual, falls, freedom),
    )  # fmt: skip


def _verdict(
    time: NDArray[np.float64], rate: float, sigma: float, residual: NDArray[np.float64],
    falls: NDArray[np.bool_], freedom: int,
) -> str:  # fmt: skip
    chance = 2 * float(student.sf(abs(rate) / sigma, freedom)) if sigma > 0 else 0.0
    if chance > _IMPROBABLE:
        text = "no trend with exposure time"
    else:
        text = f"{'rises' if rate > 0 else 'falls'} by {abs(rate):.3g} DN/s"
    worst = int(np.argmax(np.abs(residual)))
    text += f"; the line leaves at most {residual[worst]:+.3g} DN, at {time[worst]:g} s"
    if np.any(falls) and not np.all(falls):
        first = int(np.argmax(falls))
        text += f"; not monotonic: it falls from {time[first]:g} to {time[first + 1]:g} s"
    return text


def measure_dark_fit(dark: DarkLibrary, frame_sigma_dn: float) -> DarkFit | None:
    """The fit over a capture's dark levels (medians of all pixels); None for fewer than three exposures.

    frame_sigma_dn : noise of one count; a median of n pixels has 1.25 / sqrt(n) of it.
    """
    if dark.exposure_s.size < 3:
        return None
    levels = dark.level.reshape(dark.exposure_s.size, -1)
    noise = 1.2533 * frame_sigma_dn / np.sqrt(levels.shape[1] * float(dark.repeats.min()))
    return fit_dark(dark.exposure_s, levels.mean(axis=1), noise)
