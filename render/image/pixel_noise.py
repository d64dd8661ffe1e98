"""Noise of an image from the scatter of neighbouring pixels, where nothing states it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, label, minimum_filter, uniform_filter

__all__ = ["ESTIMATE_DEGREES", "high_pass", "variance_of_neighbours"]

#: Second differences along rows and columns, over 6: white noise keeps its variance, a plane disappears.
_KERNEL = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]) / 6.0
#: Side of the window over which estimated variances are averaged, px.
_WINDOW = 9
#: Degrees of freedom of an estimated variance: half the pixels of the window, since second differences of neighbours
#: share pixels.
ESTIMATE_DEGREES = _WINDOW**2 / 2


def high_pass(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Second differences of an image, scaled so that white noise keeps its variance.

    Parameters
    ----------
    picture
        (y, x) image.

    Returns
    -------
    NDArray
        (y, x) differences; the image is mirrored at its border.
    """
    return convolve(np.ascontiguousarray(picture), _KERNEL, mode="mirror")  # one band of a cube is spread over memory


def variance_of_neighbours(
    picture: NDArray[np.float64], level: NDArray[np.float64], smooth: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Variance of an image by second differences inside smooth parts, averaged over a window.

    The noise is taken as proportional to `level`, so relative variances are averaged. Outliers are cut at 30 times the
    median square of their part.

    Parameters
    ----------
    picture
        (y, x, w) image.
    level
        (y, x, w) radiance that the noise is proportional to.
    smooth
        (y, x) True for pixels away from edges. Elsewhere the mean relative variance of the smooth parts counts.

    Returns
    -------
    NDArray
        (y, x, w) variance.
    """
    inner = minimum_filter(smooth, 3)
    parts, count = label(inner)
    pixels = np.split(np.argsort(parts, axis=None, kind="stable"), np.cumsum(np.bincount(parts.ravel())))[1:-1]
    weight = uniform_filter(inner.astype(float), _WINDOW)
    result = np.empty_like(picture)
    for band in range(picture.shape[-1]):
        ground = np.ascontiguousarray(level[..., band])
        scale = np.maximum(ground, max(1e-3 * float(level[..., band].mean()), 1e-150))
        relative = (high_pass(picture[..., band]) / scale) ** 2
        typical = np.zeros(count + 1)
        typical[1:] = [_median(relative.ravel()[part]) for part in pixels]
        relative = np.minimum(relative, 30 * typical[parts])
        mean = uniform_filter(relative, _WINDOW) / np.maximum(weight, 1e-9)
        everywhere = float(relative[inner].mean()) if inner.any() else 0.0
        result[..., band] = np.where(weight > 0.2, mean, everywhere) * scale**2
    return result


def _median(values: NDArray[np.float64]) -> float:
    """Median of at least one number; faster than NumPy's for few."""
    middle = values.size // 2
    if values.size % 2:
        return float(np.partition(values, middle)[middle])
    below, above = np.partition(values, [middle - 1, middle])[middle - 1 : middle + 1]
    return float((below + above) / 2.0)
