"""Black level of a capture without darks, as stated, and its error by a rendering.

The photograph of band b is taken as g_b times the rendering plus a level d_b of the raw counts. The factor g_b keeps a
lamp or a filter that is stronger than stated from passing for a dark level. A level has the prior of what was stated
for it, so that a large offset stays visible as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture import BandTable, Capture, ReferenceTable, channel_mask

__all__ = ["BlackLevel", "black_level", "dark_level_sigmas", "fitted_dark_levels"]

#: Standard deviation of a level that was rounded to whole counts, DN: that of a uniform error of one count.
_ROUNDED_DN = float(np.sqrt(1 / 12))
#: Dark current of a sensor that nobody measured, e-/s, one standard deviation: uncooled ones have 0.1 to 20 e-/s.
_DARK_CURRENT_E_S = 10.0
#: Threshold of the Huber loss in standard deviations, so that flaws of the model hardly affect the levels.
_HUBER = 3.0
#: Rounds of the weights: the levels then change by less than a hundredth of their error.
_ROUNDS = 6
#: Largest level in its standard deviations: a size that chance gives.
_LARGEST_SIGMAS = 2.0


@dataclass(frozen=True, eq=False)
class BlackLevel:
    """The stated black level of every pixel."""

    #: (y, x) counts, DN.
    level: NDArray[np.float64]
    #: Standard deviation of the level, common to all pixels of a channel, DN: that of its rounding.
    sigma_dn: float
    #: Levels for messages, such as "512 DN" or "R 511 DN, G 512 DN".
    text: str


def black_level(capture: Capture) -> BlackLevel | None:
    """The black level that takes the place of darks.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    BlackLevel | None
        None where none is stated, where there are darks, and where they were subtracted beforehand.
    """
    manifest = capture.manifest
    counts = manifest.camera.black_level_dn
    if counts is None or manifest.darks or manifest.dark == "subtracted":
        return None
    if not isinstance(counts, dict):
        return BlackLevel(np.full(capture.shape, counts), _ROUNDED_DN, f"{counts:g} DN")
    level = np.zeros(capture.shape)
    pattern = "" if manifest.mosaic is None else manifest.mosaic.pattern
    for channel in sorted(counts, key=len):  # a letter first, then one of its pixels in the repeat
        level[channel_mask(pattern, capture.shape, channel)] = counts[channel]
    text = ", ".join(f"{channel} {value:g} DN" for channel, value in counts.items())
    return BlackLevel(level, _ROUNDED_DN, text)


def dark_level_sigmas(
    capture: Capture, tables: Sequence[BandTable | ReferenceTable], shot_dn: float
) -> NDArray[np.float64]:
    """Uncertainty of dark levels where no darks measured them.

    A stated black level is rounded, and is that of no exposure: dark current comes in addition.

    Parameters
    ----------
    capture
        The capture.
    tables
        Its photographs.
    shot_dn
        Counts per electron, DN/e-; 0 if the gain is unknown.

    Returns
    -------
    NDArray
        (table,) standard deviations, DN. 0 where darks measured the level or were subtracted beforehand, and for merged
        pictures, which are no counts.
    """
    manifest = capture.manifest
    exposure_s = np.array([table.exposure_s for table in tables])
    if manifest.darks or manifest.dark == "subtracted" or capture.is_merged:
        return np.zeros(exposure_s.size)
    return np.hypot(_ROUNDED_DN, _DARK_CURRENT_E_S * shot_dn * exposure_s)


def fitted_dark_levels(
    measured: NDArray[np.float64],
    by_level: NDArray[np.float64],
    level_sigma: NDArray[np.float64],
    *,
    signal: NDArray[np.float64],
    variance: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Dark levels in addition to the stated ones, by a rendering and robust least squares.

    Parameters
    ----------
    measured
        (band, y, x) measured signals above the stated levels, DN.
    by_level
        (band, y, x) change of the signals by a level of 1 DN.
    level_sigma
        (band,) standard deviations of the stated levels, DN.
    signal
        (band, y, x) rendered signals, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.

    Returns
    -------
    NDArray
        (band,) levels, DN, at most two of their standard deviations.
    NDArray
        (band,) their standard deviations next to free factors of the bands, DN.
    """
    levels, sigmas = np.zeros(len(level_sigma)), level_sigma.copy()
    for band, (sigma, some) in enumerate(zip(level_sigma, used, strict=True)):
        if not some.any():
            continue
        design = np.stack([by_level[band][some], signal[band][some]])
        data, weight = measured[band][some], 1 / variance[band][some]
        fit = np.array([0.0, 1.0])
        for _ in range(_ROUNDS):
            pull = np.abs(data - fit @ design) * np.sqrt(weight)
            robust = weight * np.minimum(1.0, _HUBER / np.maximum(pull, 1e-9))
            information = (design * robust) @ design.T + np.diag([sigma**-2, 0.0])
            fit = np.linalg.solve(information, design @ (robust * data))
        levels[band] = np.clip(fit[0], -_LARGEST_SIGMAS * sigma, _LARGEST_SIGMAS * sigma)
        sigmas[band] = np.sqrt(np.linalg.inv(information)[0, 0])
    return levels, sigmas
