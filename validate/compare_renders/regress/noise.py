"""How far two equal pictures may differ: variance of each pixel, its floor, correlation over wavelengths and pixels.

Standard errors that a side states are used, but never alone: neighbouring pixels of the difference tell how
much it really scatters, and the larger of the two counts. Where a side states none, the scatter of neighbours inside
smooth parts of the picture is all there is, continued to edges in proportion to the radiance there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.image import ESTIMATE_DEGREES, high_pass, variance_of_neighbours
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

__all__ = ["Noise", "local_range", "noise_of", "smooth_variance"]

#: Pixels a side of the blocks whose means tell the correlation between pixels.
_BLOCK = 4
#: So many pixels for each wavelength tell the correlation between wavelengths.
_LEAST_EACH = 8
#: Median of a chi-square of three degrees of freedom over its mean.
_MEDIAN_OF_3 = 0.789


@dataclass(frozen=True, eq=False)
class Noise:
    """Of the difference of two pictures.

    variance : (y, x, w) of each pixel. degrees : of freedom behind each. correlation : (w, w) between wavelengths; None
    where too few pixels tell it. total : (y, x) variance of the sum over wavelengths. clustering : variance of means
    over its value for independent pixels, at least 1. ratio : scatter of neighbours over what is stated, of the sum
    over wavelengths. estimated : whether a side states no standard error.
    """

    variance: NDArray[np.float64]
    degrees: float
    correlation: NDArray[np.float64] | None
    total: NDArray[np.float64]
    clustering: float
    ratio: float
    estimated: bool

    def over(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """(y, x) variance of a weighted sum over wavelengths (w,); the largest that may be, where nothing tells how
        they go together."""
        sigma = np.sqrt(self.variance) * weights
        if self.correlation is None:
            return np.asarray(sigma.sum(axis=-1) ** 2)
        return np.maximum(((sigma @ self.correlation) * sigma).sum(axis=-1), 0.0)


def local_range(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) largest less smallest value among 3 x 3 pixels; a single outlier does not count."""
    quiet = median_filter(picture, 3, mode="nearest")
    return maximum_filter(quiet, 3) - minimum_filter(quiet, 3)


def smooth_variance(level: NDArray[np.float64], variance: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """(y, x) variances as the median of their relative values in 5 x 5 pixels says; outliers do not count."""
    squared = np.maximum(level, max(1e-3 * float(level.mean()), 1e-150)) ** 2
    scale = _MEDIAN_OF_3 if degrees <= 6 else 1.0
    return median_filter(variance / squared, 5, mode="nearest") / scale * squared


def noise_of(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    smooth: NDArray[np.bool_],
    stated: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None],
    degrees: tuple[float, float],
    rounding: NDArray[np.float64] | float = 0.0,
) -> Noise:
    """Of ``difference`` (y, x, w) between pictures of about ``level`` (y, x, w).

    smooth : (y, x) pixels away from edges. stated : each side's variance. degrees : of freedom of each.
    rounding : (y, x, w) variance from the steps of files.
    """
    known = [v for v in stated if v is not None]
    estimated = len(known) < 2
    floor = (1e-6 * level) ** 2
    variance = sum(known, start=np.zeros_like(difference)) + rounding + floor
    if estimated:
        variance = np.maximum(variance, variance_of_neighbours(difference, level, smooth))
    own = [n for v, n in zip(stated, degrees, strict=True) if v is not None]
    freedom = ESTIMATE_DEGREES if estimated else float(sum(own))
    correlation = _correlation(difference, variance, level, smooth)
    ones = np.ones(difference.shape[-1])
    bare = Noise(variance, freedom, correlation, np.zeros(()), 1.0, 1.0, estimated)
    total = bare.over(ones)
    clustering, ratio = _clustering(difference.sum(axis=-1), total, level.sum(axis=-1), smooth, freedom)
    return Noise(variance, freedom, correlation, total, clustering, ratio, estimated)


def _correlation(difference: NDArray, variance: NDArray, level: NDArray, smooth: NDArray) -> NDArray[np.float64] | None:
    """(w, w) between wavelengths, from second differences of what is left over its standard deviation."""
    count = difference.shape[-1]
    inner = minimum_filter(smooth, 3)
    if count == 1:
        return np.ones((1, 1))
    if inner.sum() < _LEAST_EACH * count:
        return None
    columns = []
    for band in range(count):
        sigma = np.sqrt(smooth_variance(level[..., band], variance[..., band], 3.0))
        fine = high_pass(difference[..., band])
        least = max(1e-200 * float(np.abs(fine).max()), 1e-300)
        columns.append(np.clip(fine / np.maximum(sigma, least), -5, 5)[inner])
    with np.errstate(divide="ignore", invalid="ignore"):  # a band without light
        matrix = np.corrcoef(np.array(columns))
    return np.where(np.isfinite(matrix), matrix, np.eye(count))


def _clustering(
    total: NDArray, variance: NDArray, level: NDArray, smooth: NDArray, degrees: float
) -> tuple[float, float]:
    """How much more block means scatter than independent pixels' would, and single pixels than is stated.

    From differences of neighbouring pixels and neighbouring blocks, inside smooth parts only.
    """
    sigma = np.sqrt(np.maximum(smooth_variance(level, variance, degrees), 1e-300))
    scaled = np.clip(total / sigma, -50, 50)
    single = _difference_variance(scaled, smooth, 0.5)
    height, width = (size // _BLOCK * _BLOCK for size in total.shape)
    if height < 4 * _BLOCK or width < 4 * _BLOCK:
        return 1.0, single
    shape = height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK
    middle = np.median(scaled[smooth]) if smooth.any() else 0.0
    own = np.clip(scaled - middle, -6, 6)[:height, :width]
    means = own.reshape(shape).mean(axis=(1, 3))
    inside = np.asarray(smooth[:height, :width].reshape(shape).all(axis=(1, 3)))
    blocks = _difference_variance(means, inside, 0.5) * _BLOCK**2
    ratio = blocks / max(min(single, 36.0), 1e-12) if np.isfinite(blocks) else 1.0
    # its own standard error, about 5 per cent, must not inflate independent pixels
    return (max(1.0, ratio) if ratio > 1.15 else 1.0), single


def _difference_variance(values: NDArray, inside: NDArray[np.bool_], half: float) -> float:
    """Half the mean square of differences between neighbours that both lie inside, outliers cut."""
    found = []
    for axis in (0, 1):
        pairs = np.diff(values, axis=axis)
        both = np.logical_and(
            np.take(inside, range(1, inside.shape[axis]), axis),
            np.take(inside, range(inside.shape[axis] - 1), axis),
        )
        found.append(pairs[both])
    squares = np.concatenate(found) ** 2
    if squares.size < 20:
        return float("nan")
    return half * float(np.minimum(squares, 30 * np.median(squares)).mean())
