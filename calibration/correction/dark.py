"""Dark frames: the dark level of every pixel at any exposure, and the thermal charge in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture

__all__ = ["DarkLibrary", "read_darks"]

# With a larger share of zeros, the frames are taken as clipped at 0 DN (part of the read noise is cut off).
_CLIPPED_SHARE = 0.05
_MAD_TO_SIGMA = 1.4826
# Pixels beyond this have an unusual dark current; by noise alone this occurs in one of 1.7 million pixels.
_UNUSUAL_SIGMAS = 5.0


@dataclass(frozen=True, eq=False)
class DarkLibrary:
    """The dark frames of a capture, one level per exposure.

    exposure_s : (k,) ascending; k = 0 without dark frames. repeats : (k,) frames averaged.
    level : (k, y, x) DN, mean of the frames. bias : (y, x) DN, the level at zero exposure, from a straight line in
    time through all levels (the level itself if there is only one; 0 without dark frames).
    rate : (y, x) DN/s >= 0, the slope of the line (see ``_fit_line``). clipped : the frames are clipped at 0 DN.
    """

    exposure_s: NDArray[np.float64]
    repeats: NDArray[np.int64]
    level: NDArray[np.float64]
    bias: NDArray[np.float64]
    rate: NDArray[np.float64]
    clipped: bool

    def weights(self, exposure_s: float) -> NDArray[np.float64]:
        """(k,) weights of the levels whose weighted sum is the dark level at an exposure.

        The level measured at that exposure, if any; else linear interpolation between the two nearest exposures,
        extrapolated beyond the ends; the only level if there is one.
        """
        count = self.exposure_s.size
        weights = np.zeros(count)
        exact = np.flatnonzero(np.isclose(self.exposure_s, exposure_s, rtol=1e-6, atol=0))
        if exact.size:
            weights[exact[0]] = 1.0
        elif count == 1:
            weights[0] = 1.0
        elif count > 1:
            upper = int(np.clip(np.searchsorted(self.exposure_s, exposure_s), 1, count - 1))
            before, after = self.exposure_s[upper - 1], self.exposure_s[upper]
            weights[upper] = (exposure_s - before) / (after - before)
            weights[upper - 1] = 1 - weights[upper]
        return weights

    def at(self, exposure_s: float) -> NDArray[np.float64]:
        """(y, x) DN, the dark level at an exposure, by ``weights``; 0 without dark frames."""
        return np.tensordot(self.weights(exposure_s), self.level, axes=1)

    def thermal(self, exposure_s: float) -> NDArray[np.float64]:
        """(y, x) DN >= 0, the thermal charge in the dark level, which has shot noise."""
        return self.rate * exposure_s

    def note(self, exposure_s: float) -> str | None:
        """A note on how the dark at an exposure was obtained; None if it was measured at that exposure."""
        taken = np.any(np.isclose(self.exposure_s, exposure_s, rtol=1e-6, atol=0))
        if self.exposure_s.size == 0 or taken:
            return None
        if self.exposure_s.size == 1:
            return f"no dark frames at {exposure_s:g} s: those at {self.exposure_s[0]:g} s were used"
        inside = self.exposure_s[0] < exposure_s < self.exposure_s[-1]
        return f"no dark frames at {exposure_s:g} s: {'inter' if inside else 'extra'}polated linearly in time"


def _fit_line(
    exposure: NDArray[np.float64],
    repeats: NDArray[np.int64],
    level: NDArray[np.float64],
    frame_variance: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bias and rate of every pixel by a straight line in time through its levels.

    Short exposures determine the rate of a single pixel poorly, and noise clipped at 0 would look like dark
    current. The rates are therefore shrunk towards their median by the fraction of their variance that is noise
    (empirical Bayes, James and Stein 1961), except outliers.
    """
    mean_time = np.average(exposure, weights=repeats)
    lever = repeats * (exposure - mean_time)
    length = float(np.sum(lever * (exposure - mean_time)))
    own = np.tensordot(lever, level, axes=1) / length
    middle = float(np.median(own))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(own - middle)))
    noise = frame_variance / length  # of a rate: each level has the variance frame_variance / repeats
    share = max(0.0, 1.0 - noise / spread**2) if spread > 0 else 0.0
    usual = np.abs(own - middle) <= _UNUSUAL_SIGMAS * spread
    rate = np.maximum(np.where(usual, middle + share * (own - middle), own), 0.0)
    return np.average(level, axis=0, weights=repeats) - rate * mean_time, rate


def _frame_variance(stacks: list[NDArray[np.uint16]]) -> float:
    """DN^2, the mean variance of one frame, from repeats; 0 without repeats."""
    pairs = [stack.astype(float) for stack in stacks if stack.shape[0] > 1]
    return float(np.mean([stack.var(axis=0, ddof=1).mean() for stack in pairs])) if pairs else 0.0


def read_darks(capture: Capture) -> DarkLibrary:
    """The dark frames of a capture; an empty library if it has none or they were subtracted beforehand.

    Raises InputError for a faulty frame.
    """
    tables = sorted(capture.manifest.darks, key=lambda dark: dark.exposure_s)
    zeros = np.zeros(capture.shape)
    if not tables:
        empty = np.zeros((0, *capture.shape))
        return DarkLibrary(np.zeros(0), np.zeros(0, np.int64), empty, zeros, zeros, False)
    stacks = [capture.frames(table) for table in tables]
    exposure = np.array([table.exposure_s for table in tables])
    repeats = np.array([stack.shape[0] for stack in stacks])
    level = np.stack([stack.mean(axis=0) for stack in stacks])
    bias, rate = level[0], zeros
    if exposure.size > 1:
        bias, rate = _fit_line(exposure, repeats, level, _frame_variance(stacks))
    clipped = bool(np.mean(stacks[0] == 0) > _CLIPPED_SHARE)
    return DarkLibrary(exposure, repeats, level, bias, rate, clipped)
