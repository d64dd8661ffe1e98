"""Dark levels of a capture without darks, by a rendering.

The photograph of band b is taken as g_b times the rendering plus a level d_b of the raw counts. The factor g_b keeps a
lamp or a filter that is stronger than stated from passing for a dark level. A level has the prior of what was stated
for it, so that a large offset stays visible as one.
"""

from __future__ import annotations

import numpy as np
from cboxlab.calibration.correction import CorrectedBands
from numpy.typing import NDArray

__all__ = ["fitted_dark_levels"]

#: Threshold of the Huber loss in standard deviations, so that flaws of the model hardly affect the levels.
_HUBER = 3.0
#: Rounds of the weights: the levels then change by less than a hundredth of their error.
_ROUNDS = 6
#: Largest level in its standard deviations: a size that chance gives.
_LARGEST_SIGMAS = 2.0


def fitted_dark_levels(
    bands: CorrectedBands, signal: NDArray[np.float64], variance: NDArray[np.float64], used: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Dark levels in addition to the stated one, by robust least squares.

    Parameters
    ----------
    bands
        Corrected bands of a capture without darks.
    signal
        (band, y, x) rendered signals, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.

    Returns
    -------
    NDArray
        (band,) levels, DN, at most two standard deviations of what was stated.
    """
    measured, by_level = bands.images["signal"].values, bands.by_dark_level
    levels = np.zeros(len(signal)) if not bands.further_dark_dn.size else bands.further_dark_dn.copy()
    for band, (sigma, some) in enumerate(zip(bands.dark_sigma_dn, used, strict=True)):
        if not some.any():
            continue
        design = np.stack([by_level[band][some], signal[band][some]])
        # as before anything was subtracted, so that the prior is about the stated level
        data, weight = measured[band][some] + levels[band] * design[0], 1 / variance[band][some]
        fit = np.array([levels[band], 1.0])
        for _ in range(_ROUNDS):
            pull = np.abs(data - fit @ design) * np.sqrt(weight)
            robust = weight * np.minimum(1.0, _HUBER / np.maximum(pull, 1e-9))
            fit = np.linalg.solve((design * robust) @ design.T + np.diag([sigma**-2, 0.0]), design @ (robust * data))
        levels[band] = np.clip(fit[0], -_LARGEST_SIGMAS * sigma, _LARGEST_SIGMAS * sigma)
    return levels
