"""Dark frames: the dark level of every pixel at any exposure, and the thermal charge in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray

from ..capture import Capture
from .black_level import black_level

__all__ = ["DarkLibrary", "read_darks"]

#: Share of zeros above which frames count as clipped at 0 DN: part of their read noise is then cut off.
_CLIPPED_SHARE = 0.05
#: Standard deviations beyond which a dark current is unusual: noise alone exceeds it in one of 1.7 million pixels.
_UNUSUAL_SIGMAS = 5.0


@dataclass(frozen=True, eq=False)
class DarkLibrary:
    """The dark frames of a capture, one level per exposure."""

    #: (k,) exposure times, ascending, s; k = 0 without dark frames.
    exposure_s: NDArray[np.float64]
    #: (k,) number of frames averaged for each level.
    repeats: NDArray[np.int64]
    #: (k, y, x) mean of the frames, DN.
    level: NDArray[np.float64]
    #: (y, x) level at zero exposure, DN, by a straight line in time through all levels. With one exposure it is that
    #: level, without dark frames the stated black level, or 0.
    bias: NDArray[np.float64]
    #: (y, x) slope of the line, DN/s, 0 or more (see ``_fit_line``).
    rate: NDArray[np.float64]
    #: True if the frames are clipped at 0 DN.
    clipped: bool

    def weights(self, exposure_s: float) -> NDArray[np.float64]:
        """Weights of the levels whose weighted sum is the dark level at an exposure.

        The level measured at that exposure has weight 1, if there is one. Otherwise the two nearest exposures are
        interpolated linearly, and extrapolated beyond the ends. A single level has weight 1 at any exposure.

        Parameters
        ----------
        exposure_s
            Exposure time, s.

        Returns
        -------
        NDArray
            (k,) weights; their sum is 1 (empty without dark frames).
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
        """Dark level at an exposure.

        Parameters
        ----------
        exposure_s
            Exposure time, s.

        Returns
        -------
        NDArray
            (y, x) level by ``weights``, DN; without dark frames the stated black level, or 0.
        """
        if not self.exposure_s.size:
            return self.bias
        return np.tensordot(self.weights(exposure_s), self.level, axes=1)

    def thermal(self, exposure_s: float) -> NDArray[np.float64]:
        """Thermal charge in the dark level, which has shot noise.

        Parameters
        ----------
        exposure_s
            Exposure time, s.

        Returns
        -------
        NDArray
            (y, x) charge, DN, 0 or more.
        """
        return self.rate * exposure_s

    def note(self, exposure_s: float) -> str | None:
        """Note on an exposure at which no dark frames were taken.

        Parameters
        ----------
        exposure_s
            Exposure time, s.

        Returns
        -------
        str | None
            How its dark level was obtained; None if it was measured at that exposure, or without dark frames.
        """
        is_measured = np.any(np.isclose(self.exposure_s, exposure_s, rtol=1e-6, atol=0))
        if self.exposure_s.size == 0 or is_measured:
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
    """Bias (DN) and rate (DN/s) of every pixel by a straight line in time through its levels.

    Short exposures determine the rate of a single pixel poorly, and noise clipped at 0 would look like dark
    current. The rates are therefore shrunk towards the mean of usual ones by the fraction of their variance that is
    noise (empirical Bayes, James and Stein 1961), except outliers.
    """
    mean_time = np.average(exposure, weights=repeats)
    lever = repeats * (exposure - mean_time)
    length = float(np.sum(lever * (exposure - mean_time)))
    fitted_rate = np.tensordot(lever, level, axes=1) / length
    noise = frame_variance / length  # of a rate: each level has the variance frame_variance / repeats
    centre = float(np.median(fitted_rate))
    by_deviation = robust_sigma(fitted_rate - centre)
    spread = max(by_deviation, float(np.sqrt(noise)))
    share = max(0.0, 1.0 - noise / spread**2) if spread > 0 else 0.0
    usual = np.abs(fitted_rate - centre) <= _UNUSUAL_SIGMAS * spread
    # the median of levels in whole counts is off by up to half a step, their mean is not
    middle = float(fitted_rate[usual].mean())
    rate = np.maximum(np.where(usual, middle + share * (fitted_rate - middle), fitted_rate), 0.0)
    return np.average(level, axis=0, weights=repeats) - rate * mean_time, rate


def _frame_variance(stacks: list[NDArray[np.uint16]]) -> float:
    """Mean variance of one frame by its repeats, DN^2; 0 without repeats."""
    pairs = [stack.astype(float) for stack in stacks if stack.shape[0] > 1]
    return float(np.mean([stack.var(axis=0, ddof=1).mean() for stack in pairs])) if pairs else 0.0


def read_darks(capture: Capture) -> DarkLibrary:
    """The dark levels of a capture.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    DarkLibrary
        Without levels (k = 0) if the capture has no dark frames or the dark was subtracted beforehand.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    tables = sorted(capture.manifest.darks, key=lambda dark: dark.exposure_s)
    zeros = np.zeros(capture.shape)
    if not tables:
        empty, black = np.zeros((0, *capture.shape)), black_level(capture)
        bias = zeros if black is None else black.level
        return DarkLibrary(np.zeros(0), np.zeros(0, np.int64), empty, bias, zeros, False)
    stacks = [capture.frames(table) for table in tables]
    exposure = np.array([table.exposure_s for table in tables])
    repeats = np.array([stack.shape[0] for stack in stacks])
    level = np.stack([stack.mean(axis=0) for stack in stacks])
    bias, rate = level[0], zeros
    if exposure.size > 1:
        bias, rate = _fit_line(exposure, repeats, level, _frame_variance(stacks))
    clipped = bool(np.mean(stacks[0] == 0) > _CLIPPED_SHARE)
    return DarkLibrary(exposure, repeats, level, bias, rate, clipped)
