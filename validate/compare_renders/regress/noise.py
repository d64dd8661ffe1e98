"""Noise of a difference: variances, correlation of wavelengths, clustering of pixels.

Standard errors that a side states are used, but never alone: neighbouring pixels of the difference show how much it
scatters, and the larger of the two counts. Where a side states none, noise is estimated by the scatter of neighbours
inside smooth parts of the picture, and continued to edges in proportion to the radiance there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.image import ESTIMATE_DEGREES, high_pass, variance_of_neighbours
from cboxlab.utils.distributions import robust_sigma, student_tail
from cv2 import medianBlur
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

from .patterns import clustering_by_filter, clustering_of_blocks, clustering_of_neighbours, difference_variance

__all__ = [
    "Noise",
    "batch_clustering",
    "local_range",
    "noise_of",
    "paired_variance",
    "pixels_that_differ",
    "quieter_part",
    "roughness_of",
    "row_sums",
    "smooth_variance",
    "variance_of",
]

#: Ratio of the scatter of block means to that of independent pixels, above which pixels are correlated: three times
#: the ratio's own standard error of about 5 %.
_MIN_CLUSTERING = 1.15
#: Relative difference of pictures from which it is no correlated noise: denoised ones agree better.
_MOST_APART = 0.1
#: The same over the stated errors: errors of batches contain correlated noise.
_MOST_SPREAD = 1.5
#: Sum of the correlation from which noise with stated errors went through a filter: estimates of independent noise are
#: lower in pictures of 40 x 40 px.
_CLEAR_FILTER = 1.6
#: Relative difference of single pictures from which it is none of a denoiser's blotches: twice that of a bad one.
_GROSS = 0.2
#: Variance of means over that of independent pixels in such pictures: that of a pixel filter three pixels wide.
_WIDEST_FILTER = 6.0
#: Groups of pixels by their light, in which a change by light is looked for.
_LIGHT_GROUPS = 8
#: Fewest pixels of such a group.
_MIN_LIGHT_PX = 12
#: Fewest pixels away from edges whose neighbours give a variance.
_MIN_SMOOTH_PIXELS = 12
#: Squares count at most this many times their median in a mean: 30 cuts outliers and leaves normal noise alone.
_SQUARE_CUT = 30
#: Smallest number of pixels per wavelength from which the correlation between wavelengths is estimated.
_MIN_PIXELS_PER_BAND = 8
#: Standard deviations at which residuals are clipped in the correlation between wavelengths: outliers would rule it.
_CORRELATION_CLIP = 5
#: Correlation of two sides' cubes with their means subtracted, from which they have the same random numbers.
_PAIRED_CORRELATION = 0.5
#: Median of a chi-square of three degrees of freedom over its mean.
_MEDIAN_OF_3 = 0.789
#: Degrees of freedom up to which a median of variances is corrected by that ratio.
_FEW_DEGREES = 6
#: Relative standard deviation of a pixel that is always allowed: single precision of files.
_ROUNDING = 1e-6
#: Largest expected part of the pixels listed as differing that do not differ (Benjamini and Hochberg 1995).
_FALSE_DISCOVERIES = 0.01
#: Most degrees of freedom of a single pixel, whose noise is not normal.
_MAX_PIXEL_DEGREES = 8.0
#: Bands whose variances are estimated at once, which bounds memory.
_BANDS_AT_ONCE = 16
#: Rows of the picture whose correlation is summed at once, which bounds memory.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the difference of two pictures."""

    #: (y, x, w) variance of each pixel.
    variance: NDArray[np.float64]
    #: Degrees of freedom behind each variance.
    degrees: float
    #: (w, w) correlation between wavelengths; None where there are too few pixels for an estimate.
    correlation: NDArray[np.float64] | None
    #: (y, x) variance of the sum over wavelengths.
    total: NDArray[np.float64]
    #: Variance of means over its value for independent pixels, at least 1.
    clustering: float
    #: Scatter of neighbours over the stated variance, for the sum over wavelengths; NaN where there are too few.
    ratio: float
    #: Whether a side states no standard error.
    estimated: bool

    @property
    def filtered(self) -> bool:
        """Whether the noise is estimated and correlated between pixels."""
        return self.estimated and self.clustering > 1

    def over(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance of a weighted sum over wavelengths.

        Without a known correlation wavelengths count as fully correlated, which gives the largest variance.

        Parameters
        ----------
        weights
            (w,) weights.

        Returns
        -------
        NDArray
            (y, x) variance, at least 0.
        """
        return np.stack([self._over_row(row, weights) for row in range(len(self.variance))])

    def _over_row(self, row: int, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """(x,) ``over`` in one row of the picture, so that temporaries are small."""
        sigma = np.sqrt(self.variance[row]) * weights
        if self.correlation is None:
            return np.asarray(sigma.sum(axis=-1) ** 2)
        return np.maximum(((sigma @ self.correlation) * sigma).sum(axis=-1), 0.0)

    def of_band(self, band: int) -> NDArray[np.float64]:
        """Variance of one band: ``over`` its unit vector, without the products with all other bands.

        Parameters
        ----------
        band
            Number of the band.

        Returns
        -------
        NDArray
            (y, x) variance.
        """
        sigma = np.sqrt(self.variance[..., band])
        if self.correlation is None:
            return sigma**2
        return np.maximum(sigma * self.correlation[band, band] * sigma, 0.0)

    def with_quiet_outliers(self, level: NDArray[np.float64], outlier: NDArray[np.bool_]) -> Noise:
        """The same noise with variances of outliers from the relative variances of their neighbours.

        Parameters
        ----------
        level
            (y, x, w) radiance.
        outlier
            (y, x) outliers.

        Returns
        -------
        Noise
            Noise with other ``variance`` and ``total`` at outliers.
        """
        variance, total = self.variance.copy(), self.total.copy()
        for band in range(variance.shape[-1]):
            quiet = smooth_variance(level[..., band], self.variance[..., band], self.degrees)
            variance[..., band][outlier] = quiet[outlier]
        noise, all_bands = replace(self, variance=variance), np.ones(variance.shape[-1])
        for row in np.flatnonzero(outlier.any(axis=1)):
            total[row] = noise._over_row(int(row), all_bands)
        return replace(noise, total=total)


def local_range(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest less smallest value among 3 x 3 pixels, after a median filter.

    The filter removes single outliers.

    Parameters
    ----------
    picture
        (y, x) values.

    Returns
    -------
    NDArray
        (y, x) range, at least 0.
    """
    quiet = median_filter(picture, 3, mode="nearest")
    return maximum_filter(quiet, 3) - minimum_filter(quiet, 3)


def smooth_variance(level: NDArray[np.float64], variance: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """Variances from the median relative variance of 5 x 5 pixels, which outliers do not change.

    Parameters
    ----------
    level
        (y, x) radiance, to which the standard deviation is proportional.
    variance
        (y, x) variance.
    degrees
        Degrees of freedom behind each variance. For few of them the median is corrected to the mean.

    Returns
    -------
    NDArray
        (y, x) variance.
    """
    squared = np.maximum(level, max(1e-3 * float(level.mean()), 1e-150)) ** 2
    return _smooth(variance / squared, degrees) * squared


def _smooth(relative: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """(y, x) relative variances by the median of 5 x 5 pixels, in single precision.

    The filter of OpenCV takes a hundredth of the time of SciPy's.
    """
    scale = _MEDIAN_OF_3 if degrees <= _FEW_DEGREES else 1.0
    typical = float(np.median(relative)) or 1.0  # single precision holds values around 1 whatever the pictures' units
    values = np.minimum(relative / typical, np.finfo(np.float32).max).astype(np.float32, order="C")
    return np.asarray(medianBlur(values, 5), float) * (typical / scale)


def row_sums(cube: NDArray[np.float64], weights: NDArray[np.float64], root: bool = False) -> NDArray[np.float64]:
    """Weighted sums over wavelengths, row by row of the picture, so that temporaries are small.

    Parameters
    ----------
    cube
        (y, x, w) values.
    weights
        (w,) weights.
    root
        Whether square roots of the values are summed.

    Returns
    -------
    NDArray
        (y, x) sums.
    """
    return np.stack([(np.sqrt(row) if root else row) @ weights for row in cube])


def variance_of(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    smooth: NDArray[np.bool_],
    side_variances: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None],
    degrees: tuple[float, float],
    rounding: NDArray[np.float64] | float = 0.0,
) -> tuple[NDArray[np.float64], float]:
    """Variance of each pixel of a difference, and the degrees of freedom behind it.

    Parameters
    ----------
    difference
        (y, x, w) difference of two pictures.
    level
        (y, x, w) radiance of either.
    smooth
        (y, x) pixels away from edges.
    side_variances
        (y, x, w) variance that each side states, or None.
    degrees
        Degrees of freedom of each side's variance.
    rounding
        (y, x, w) variance from the steps in which files store values.

    Returns
    -------
    variance
        (y, x, w) sum of the stated variances and of rounding. Where a side states none, it is at least the scatter of
        neighbours.
    degrees
        Degrees of freedom behind each variance.
    """
    variances = [v for v in side_variances if v is not None]
    variance = np.zeros_like(difference)
    for part in variances:
        variance += part
    variance += rounding
    for row, radiance in zip(variance, level, strict=True):
        row += (_ROUNDING * radiance) ** 2
    if len(variances) == len(side_variances):
        return variance, float(sum(degrees))
    for first in range(0, difference.shape[-1], _BANDS_AT_ONCE):
        bands = np.s_[..., first : first + _BANDS_AT_ONCE]
        scatter = variance_of_neighbours(difference[bands], level[bands], smooth)
        variance[bands] = np.maximum(variance[bands], scatter)
    return variance, ESTIMATE_DEGREES


def paired_variance(
    baseline: NDArray[np.float64] | None, candidate: NDArray[np.float64] | None, *, same_seeds: bool = False
) -> NDArray[np.float64] | None:
    """Variance of the mean difference of cubes with the same random numbers, cube by cube.

    The cubes have the same random numbers where the user says so, or where their deviations from their means are alike.

    Parameters
    ----------
    baseline, candidate
        (b, y, x, w) independent cubes of each side, in the order of their seeds; None without several.
    same_seeds
        Whether the user says so.

    Returns
    -------
    NDArray or None
        (y, x, w) variance; None for independent sides.
    """
    if baseline is None or candidate is None or baseline.shape != candidate.shape:
        return None
    if same_seeds:
        return _of_pairs(baseline, candidate)
    off = [cubes.sum(axis=-1) - cubes.sum(axis=-1).mean(axis=0) for cubes in (baseline, candidate)]
    # one firefly would rule the correlation
    limits = [_CORRELATION_CLIP * np.sqrt(np.median(each**2)) for each in off]
    if not min(limits) > 0:
        return None
    first, second = (np.clip(each, -limit, limit) for each, limit in zip(off, limits, strict=True))
    alike = float((first * second).sum()) / float(np.sqrt((first**2).sum() * (second**2).sum()))
    if alike < _PAIRED_CORRELATION:
        return None
    return _of_pairs(baseline, candidate)


def _of_pairs(baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x, w) variance of the mean difference of pairs of cubes."""
    return np.asarray((candidate - baseline).var(axis=0, ddof=1) / len(baseline))


def noise_of(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    smooth: NDArray[np.bool_],
    side_variances: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None],
    degrees: tuple[float, float],
    rounding: NDArray[np.float64] | float = 0.0,
    *,
    stepped: bool = False,
    paired: bool = False,
    variance: tuple[NDArray[np.float64], float] | None = None,
) -> Noise:
    """Noise of the difference of two pictures.

    Parameters
    ----------
    difference, level, smooth, side_variances, degrees, rounding
        As in ``variance_of``.
    stepped
        Whether tiles differ by factors: they are no correlation between pixels.
    paired
        Whether both sides have the same random numbers: most pixels are then equal, and variances of single ones say
        little.
    variance
        Outcome of ``variance_of`` for these arguments; None computes it.

    Returns
    -------
    Noise
        Variances, correlation between wavelengths, clustering of pixels.
    """
    computed = variance or variance_of(difference, level, smooth, side_variances, degrees, rounding)
    estimated = any(v is None for v in side_variances)
    correlation = _correlation(difference, computed[0], level, smooth)
    all_bands = np.ones(difference.shape[-1])
    noise = Noise(*computed, correlation, np.zeros(()), 1.0, 1.0, estimated)
    total = noise.over(all_bands)
    sums = difference.sum(axis=-1), total, level.sum(axis=-1)
    clustering, ratio = _clustering(*sums, smooth, computed[1], paired=paired, stepped=stepped, estimated=estimated)
    return replace(noise, total=total, clustering=clustering, ratio=ratio)


def _correlation(difference: NDArray, variance: NDArray, level: NDArray, smooth: NDArray) -> NDArray[np.float64] | None:
    """(w, w) correlation between wavelengths, from scaled second differences."""
    count, height = difference.shape[-1], len(difference)
    inner = minimum_filter(smooth, 3)
    pixels = int(inner.sum())
    if count == 1:
        return np.ones((1, 1))
    if pixels < _MIN_PIXELS_PER_BAND * count:
        return None
    floors = [max(1e-3 * float(level[..., band].mean()), 1e-150) for band in range(count)]
    sums, products = np.zeros(count), np.zeros((count, count))
    for top in range(0, height, _ROWS_AT_ONCE):
        rows = slice(max(top - 2, 0), min(top + _ROWS_AT_ONCE + 2, height))
        part = slice(top - rows.start, min(top + _ROWS_AT_ONCE, height) - rows.start)
        used = inner[rows][part]
        residuals = np.empty((count, int(used.sum())))
        for band in range(count):
            squared = np.maximum(level[rows, :, band], floors[band]) ** 2
            sigma = np.sqrt((_smooth(variance[rows, :, band] / squared, 3.0) * squared)[part])[used]
            fine = high_pass(difference[rows, :, band])[part][used]
            with np.errstate(over="ignore"):
                quotient = fine / np.maximum(sigma, 1e-300)
            residuals[band] = np.clip(quotient, -_CORRELATION_CLIP, _CORRELATION_CLIP)
        sums += residuals.sum(axis=1)
        products += residuals @ residuals.T
    covariance = products - np.outer(sums, sums) / pixels
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):  # a band without light
        matrix = np.clip(covariance / deviation[:, None] / deviation, -1, 1)
    return np.where(np.isfinite(matrix), matrix, np.eye(count))


def _clustering(
    total: NDArray,
    variance: NDArray,
    level: NDArray,
    smooth: NDArray,
    degrees: float,
    *,
    paired: bool,
    stepped: bool,
    estimated: bool,
) -> tuple[float, float]:
    """Scatter of block means over independent pixels', and of pixels over the variance.

    Both come from differences of neighbouring pixels and blocks inside smooth parts. Where noise fills blocks, as after
    a denoiser, the correlation by distance is summed instead.
    """
    sigma = np.sqrt(np.maximum(smooth_variance(level, variance, degrees), 1e-300))
    if paired:
        sigma = np.maximum(level, 1e-3 * max(float(level.mean()), 1e-300))
        sigma = sigma * max(float(np.sqrt(np.mean((total / sigma)[smooth] ** 2))) if smooth.any() else 1.0, 1e-300)
    steady = total - _by_light(total, level, smooth) if estimated else total
    single = difference_variance(np.clip(total / sigma, -50, 50), smooth)
    quotient = steady / sigma
    if not smooth.any():
        return 1.0, single
    middle = np.median(quotient[smooth])
    spread = max(1.0, robust_sigma(quotient[smooth] - middle))
    clipped = np.clip((quotient - middle) / spread, -6, 6)
    ratio = clustering_of_blocks(clipped, smooth, partly=estimated)
    relative = (total / np.maximum(level, 1e-3 * max(float(level.mean()), 1e-300)))[smooth]
    apart = robust_sigma(relative - np.median(relative))
    by_filter = clustering_by_filter(clipped, smooth)
    if by_filter is not None and estimated:
        ratio = max(clustering_of_blocks(clipped, smooth, curved=True, partly=True), by_filter)
    elif by_filter is not None and by_filter > _CLEAR_FILTER and not stepped and spread < _MOST_SPREAD:
        ratio = max(ratio, by_filter)
    elif estimated and apart >= _GROSS:
        ratio = _WIDEST_FILTER
    elif not stepped and (estimated or (apart < _MOST_APART and spread < _MOST_SPREAD)):
        ratio = max(ratio, clustering_of_neighbours(clipped, smooth))
    return (max(1.0, ratio) if ratio > _MIN_CLUSTERING else 1.0), single


def _by_light(total: NDArray, level: NDArray, smooth: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(y, x) part of a difference that is a function of the light.

    A factor, a constant and a power are such functions, noise is none. The part is the median of pixels of similar
    light.
    """
    used = smooth & (level > 1e-3 * max(float(level.mean()), 1e-300))
    if used.sum() < _LIGHT_GROUPS * _MIN_LIGHT_PX:
        return np.zeros_like(total)
    # the mean of both pictures, whose noise is nearly independent of their difference's
    half = np.maximum(level + 0.5 * total, 1e-3 * float(level.mean()))
    light, relative = np.log(half[used]), total[used] / half[used]
    groups = np.array_split(np.argsort(light), _LIGHT_GROUPS)
    at, medians = (np.array([np.median(values[g]) for g in groups]) for values in (light, relative))
    result = np.zeros_like(total)
    result[used] = half[used] * np.interp(light, at, medians)
    return result


def batch_clustering(batches: NDArray[np.float64], level: NDArray[np.float64], smooth: NDArray[np.bool_]) -> float:
    """Variance of means over that of independent pixels, from independent pictures.

    A change between two sides does not enter, unlike in their difference.

    Parameters
    ----------
    batches
        (b, y, x, w) independent pictures of one side.
    level
        (y, x) radiance, summed over wavelengths.
    smooth
        (y, x) pixels away from edges.

    Returns
    -------
    float
        The mean ratio of the pictures, at least 1.
    """
    if not smooth.any():
        return 1.0
    ratios = []
    totals = batches.sum(axis=-1)
    scale = np.maximum(level, 1e-3 * max(float(level.mean()), 1e-300))
    for off in (totals - totals.mean(axis=0)) / scale:
        spread = robust_sigma(off[smooth])
        values = np.clip(off / max(spread, 1e-300), -6, 6)
        by_filter = clustering_by_filter(values, smooth)
        wide = clustering_of_neighbours(values, smooth) if by_filter is None else by_filter
        ratios.append(max(1.0, clustering_of_blocks(values, smooth), wide))
    return float(np.mean(ratios))


def quieter_part(baseline: NDArray, candidate: NDArray, smooth: NDArray[np.bool_]) -> float:
    """Weight of the candidate in a mean of two pictures, each weighted by the other's variance.

    The variances are those of neighbouring pixels inside smooth parts.

    Parameters
    ----------
    baseline, candidate
        (y, x) pictures.
    smooth
        (y, x) pixels away from edges.

    Returns
    -------
    float
        The weight, 0 to 1; 0.5 where there are too few smooth pixels.
    """
    inner = minimum_filter(smooth, 3)
    if inner.sum() < _MIN_SMOOTH_PIXELS:
        return 0.5
    squares = [high_pass(picture)[inner] ** 2 for picture in (baseline, candidate)]
    variances = [float(np.minimum(s, _SQUARE_CUT * np.median(s)).mean()) for s in squares]
    return variances[0] / sum(variances) if sum(variances) > 0 else 0.5


def roughness_of(
    baseline: NDArray[np.float64], candidate: NDArray[np.float64], body: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Variance of each pixel relative to other pixels, from the variances that two sides state.

    A variance that is estimated together with a mean is small where the mean is small, and weights from it would bias
    the mean. The two sides are weighted so that these biases of their difference cancel.

    Parameters
    ----------
    baseline, candidate
        (y, x, w) variances.
    body
        (y, x) pixels but those of the lamp.

    Returns
    -------
    NDArray
        (y, x) relative variance, about 1 on average.
    """
    sums = [np.stack([np.sqrt(row).sum(axis=-1) for row in variance]) for variance in (baseline, candidate)]
    first, second = sums[0] ** 2, sums[1] ** 2
    scales = [max(float(variance[body].mean()), 1e-300) for variance in (first, second)]
    part = np.sqrt(scales[0]) / np.sqrt(scales).sum()
    return np.asarray((1 - part) * first / scales[0] + part * second / scales[1])


def pixels_that_differ(
    total: NDArray[np.float64], level: NDArray[np.float64], noise: Noise, body: NDArray[np.bool_]
) -> int:
    """Count of pixels that differ by themselves, at a false discovery rate of 1 %.

    Pixels are tested as Student's t. The degrees of freedom are twice those behind a variance, since neighbours share
    variances, and at most 8, since single pixels are not normal.

    Parameters
    ----------
    total
        (y, x) difference, summed over wavelengths.
    level
        (y, x, w) baseline without outliers.
    noise
        Noise of the difference.
    body
        (y, x) pixels that are tested.

    Returns
    -------
    int
        The number.
    """
    sigma = np.sqrt(smooth_variance(level.sum(axis=-1), noise.total, noise.degrees))
    sigma = sigma * np.sqrt(max(1.0, noise.ratio if np.isfinite(noise.ratio) else 1.0))
    size, scatter = np.abs(total[body]), sigma[body]
    # without scatter every difference is one
    sigmas = np.divide(size, scatter, out=np.where(size > 0, np.inf, 0.0), where=scatter > 1e-280)
    probability = np.sort(2 * student_tail(sigmas, min(_MAX_PIXEL_DEGREES, 2 * noise.degrees)))
    below = np.flatnonzero(
        probability <= _FALSE_DISCOVERIES * np.arange(1, probability.size + 1) / max(probability.size, 1)
    )
    return int(below[-1]) + 1 if below.size else 0
