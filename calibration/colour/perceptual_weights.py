"""Filter weights of least colour difference, for a few broad channels.

Three broad channels cannot reconstruct the colour-matching functions. Weights of least relative error then spend their
freedom on X, Y and Z alike, however small one of them is. These weights minimise the colour difference itself, to first
order: the differences of lightness, chroma and hue over the widths that CIEDE2000 gives them, averaged over radiances.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..instrument import BandResponse, colour_matching_functions
from .colorimetry import FilterWeights, described

__all__ = ["perceptual_weights"]

#: CIELAB's f is linear below this cube of 6/29.
_LINEAR_BELOW = (6.0 / 29.0) ** 3
#: Slope of that linear part.
_LINEAR_SLOPE = 1.0 / (3.0 * (6.0 / 29.0) ** 2)
#: Growth of CIEDE2000's chroma width per unit of chroma.
_CHROMA_WIDTH = 0.045
#: Growth of its hue width per unit of chroma, at the mean hue.
_HUE_WIDTH = 0.015
#: Chroma below which CIEDE2000 stretches the axis from green to red.
_GREYISH = 25.0
#: Relative ridge that bounds the weights of collinear bands, far below any noise.
_RIDGE = 1e-6


def _difference_rows(xyz: NDArray[np.float64], white: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3, 3) differences of lightness, chroma and hue over their widths, per unit of X, Y, Z."""
    ratio = np.maximum(xyz / white, 0.0)
    is_linear = ratio < _LINEAR_BELOW
    root = np.cbrt(np.maximum(ratio, _LINEAR_BELOW))
    f = np.where(is_linear, _LINEAR_SLOPE * ratio + 4.0 / 29.0, np.cbrt(ratio))
    slope = np.where(is_linear, _LINEAR_SLOPE, 1.0 / (3.0 * root**2)) / white
    light = 116.0 * f[:, 1] - 16.0
    a, b = 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])
    seventh = np.hypot(a, b) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(seventh / (seventh + _GREYISH**7))
    a = stretch * a
    chroma = np.hypot(a, b)
    cosine, sine = np.cos(np.arctan2(b, a)), np.sin(np.arctan2(b, a))
    zero = np.zeros(len(xyz))
    lab = np.array(
        [
            [zero, 116.0 * slope[:, 1], zero],
            [500.0 * stretch * slope[:, 0], -500.0 * stretch * slope[:, 1], zero],
            [zero, 200.0 * slope[:, 1], -200.0 * slope[:, 2]],
        ]
    )
    above = (light - 50.0) ** 2
    widths = 1 + 0.015 * above / np.sqrt(20.0 + above), 1 + _CHROMA_WIDTH * chroma, 1 + _HUE_WIDTH * chroma
    rows = (
        lab[0] / widths[0],
        (cosine * lab[1] + sine * lab[2]) / widths[1],
        (cosine * lab[2] - sine * lab[1]) / widths[2],
    )
    return np.moveaxis(np.array(rows), -1, 0)


def perceptual_weights(
    responses: Sequence[BandResponse],
    radiances: NDArray[np.float64],
    white: NDArray[np.float64],
    relative_noise: ArrayLike,
) -> FilterWeights:
    """Filter weights of least mean square colour difference over radiances.

    Parameters
    ----------
    responses
        Response of every band, on one grid.
    radiances
        (n, wavelength) radiances, see ``training_radiances``.
    white
        (n, wavelength) radiance of a perfect diffuser in the light of each.
    relative_noise
        Standard deviation of a band's signal over its rms in the ensemble (one number or (band,)).

    Returns
    -------
    FilterWeights
        Weights of the method "perceptual".
    """
    step, goal = responses[0].grid.weights, colour_matching_functions()
    noise = np.broadcast_to(np.asarray(relative_noise, float), (len(responses),))
    signal = radiances @ (step * np.stack([response.response for response in responses])).T
    exact, whites = (light @ (step * goal).T for light in (radiances, white))
    scale = np.sqrt(np.mean(signal**2, axis=0))
    scale[scale == 0] = 1.0
    rows = _difference_rows(exact / whites[:, 1:2], whites / whites[:, 1:2]) / whites[:, 1, None, None]
    columns = np.einsum("nda,nb->ndab", rows, signal / scale).reshape(3 * len(signal), -1)
    sought = np.einsum("nda,na->nd", rows, exact).ravel()
    # noise of a band adds the mean square of its weights' own colour difference
    metric = np.linalg.cholesky(np.einsum("nda,ndc->ac", rows, rows)).T
    loading = np.einsum("da,bc->dbac", metric, np.diag(np.maximum(noise, _RIDGE))).reshape(3 * len(responses), -1)
    solution = np.linalg.lstsq(
        np.concatenate([columns, loading]), np.append(sought, np.zeros(len(loading))), rcond=None
    )
    weights = solution[0].reshape(3, len(responses)) / scale
    return described(responses, weights, goal, "perceptual", noise)
