"""Squares of the picture in which an object is missing, repainted or moved.

Squares of some sizes are laid over the difference at all positions. A finding is clearer than all squares elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cboxlab.utils.distributions import fisher_tail, student_tail
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter, uniform_filter

from .difference import Difference, Finding, sigma_of

__all__ = ["moved_part", "small_part"]

#: Edges of the squares, px, odd: objects of some pixels to a fifth of a small picture.
_EDGES_PX = (3, 5, 7, 11)
#: Pixels a side of the surroundings: wider than the largest square.
_AROUND_PX = 17
#: Median of the square of a normal number.
_MEDIAN_OF_SQUARE = 0.455
#: Fewest independent pixels of a square.
_MIN_INDEPENDENT = 5.0
#: Scatters of the surroundings at which a pixel counts: those of an object exceed them.
_SQUARE_SIGMAS = 4.0
#: Degrees of freedom of the steps inside a square over its independent pixels: neighbours share pixels.
_OF_STEPS = 0.75
#: Fewest degrees of freedom of a square: those of the smallest one behind a filter.
_LEAST_DEGREES = 3.0
#: Most degrees of freedom: noise of renderings is not normal.
_SQUARE_DEGREES = 20.0
#: Least light of a pixel over the median one: filters spread a lamp's noise over dark surroundings.
_LEAST_LEVEL = 0.1
#: Least scatter of the surroundings over the typical one: where a denoiser left little noise, its errors are no part.
_LEAST_SCATTER = 0.3
#: Relative scatter that is always allowed: single precision of files.
_PRECISION = 1e-6
#: Squares elsewhere that may have changed, too.
_OTHERS = 2
#: Factor by which a finding has to be clearer than all others: a denoiser's noisy spots are about alike.
_CLEARER = 2.0
#: Pixels a side of the smallest picture.
_LEAST_PX = 24
#: Edges of the squares in which something may have moved, px: an object with the surroundings that it uncovers.
_MOVED_PX = (7, 11, 15)
#: Median of the sum of two squares of normal numbers.
_MEDIAN_OF_TWO = 1.386
#: Width of the Gaussian that smooths slopes, px: wide ones have less noise, narrow ones lose fewer edges.
_SLOPE_PX = 0.8
#: Part of the pixels with the steepest slopes, whose scatter shows the noise of places inside a pixel.
_STEEPEST = 0.3
#: Scatters at which a pixel's difference is cut among slopes.
_SLOPE_CUT = 4.0
#: Least determinant of the slopes over their squared sum: slopes of one direction show motion along it.
_ONE_DIRECTION = 1e-3
#: Most degrees of freedom of a motion: its products have lighter tails than means, since cut pixels weigh less.
_MOST_OF_SLOPES = 40.0
#: Rounding of a moving sum over the largest one.
_ROUNDING = 1e-10
#: Fewest pixels that slopes weight alike in a square.
_LEAST_SLOPES = 6.0


def small_part(difference: Difference, baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> Finding | None:
    """Square that differs most from its surroundings: an object that is missing or repainted.

    Squares of some sizes are laid over the difference at all positions, edges included, since the scene cancels in it.
    The difference counts relative to the mean of both sides, where an object on a texture is one step. A pixel counts
    as at most some scatters, so that fireflies fill no square. The mean of a square is compared with the larger of two
    scatters: that of neighbours inside it, which an object leaves alone, and that of the surroundings. The pictures are
    whole: an object of few pixels looks like an outlier elsewhere. A denoiser leaves several noisy spots, and a finding
    has to be clearer than these.

    Parameters
    ----------
    difference
        The difference.
    baseline, candidate
        (y, x) pictures with their outliers, summed over wavelengths.

    Returns
    -------
    Finding or None
        The size is the square's mean difference over the mean light of both sides there. None for small pictures, and
        for noise that reaches over more than a few pixels.
    """
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    if min(used.shape) < _LEAST_PX or not used.any() or not difference.of_pixel_filter:
        return None
    half = 0.5 * (baseline + candidate)
    least = _LEAST_LEVEL * float(np.median(half[used])) + 1e-300
    relative = (candidate - baseline) / np.maximum(half, least)
    off = relative - median_filter(relative, _AROUND_PX, mode="reflect")
    # pixels without light do not show the noise of their neighbours: the typical noise stands for theirs
    with_light = half > least
    squares = np.where(with_light, off**2, np.median(off[with_light] ** 2) if with_light.any() else 0.0)
    around = median_filter(squares, _AROUND_PX, mode="reflect") / _MEDIAN_OF_SQUARE
    around = np.maximum(around, _LEAST_SCATTER**2 * float(np.median(around[used])) + 1e-300)
    limit = _SQUARE_SIGMAS * np.sqrt(around)
    off = np.where(used, np.clip(off, -limit, limit), 0.0)
    steps = [0.5 * np.diff(off, axis=axis) ** 2 for axis in (0, 1)]
    by_steps = float(np.mean([np.median(step) for step in steps])) / _MEDIAN_OF_SQUARE
    filtered = max(1.0, float(np.median(around[used])) / max(by_steps, 1e-300))
    looks = sum(float(used.sum()) / (edge / 2) ** 2 for edge in _EDGES_PX)
    findings = []
    for edge in _EDGES_PX:
        independent = edge**2 / difference.clustering
        if independent >= _MIN_INDEPENDENT and min(used.shape) > edge:
            inside = filtered * _steps_inside(steps, edge)
            findings.append(_clearest(off, (inside, around), used, edge, independent, looks))
    return min(findings, key=lambda finding: finding.probability, default=None)


def _steps_inside(steps: Sequence[NDArray[np.float64]], edge: int) -> NDArray[np.float64]:
    """(y, x) mean of the steps between neighbours inside a square around each pixel."""
    down, across = steps
    down = np.pad(down, ((0, 1), (0, 0)), mode="edge")
    across = np.pad(across, ((0, 0), (0, 1)), mode="edge")
    return np.asarray(
        0.5 * uniform_filter(down, (edge - 1, edge), mode="nearest")
        + 0.5 * uniform_filter(across, (edge, edge - 1), mode="nearest")
    )


def _clearest(
    off: NDArray[np.float64],
    scatters: tuple[NDArray[np.float64], NDArray[np.float64]],
    used: NDArray[np.bool_],
    edge: int,
    independent: float,
    looks: float,
) -> Finding:
    """Clearest square of one size.

    off : (y, x) relative difference less that of the surroundings. scatters : (y, x) its variance inside the square and
    around it. independent : number of independent pixels of a square. looks : squares of all sizes at positions that do
    not overlap much.
    """
    inside, around = scatters
    mean = uniform_filter(off, edge, mode="nearest")
    scatter = np.sqrt(np.maximum(inside, around) / independent)
    sigmas = np.abs(mean) / scatter
    few = float(np.clip(_OF_STEPS * independent, _LEAST_DEGREES, _SQUARE_DEGREES))
    shares = 2 * looks * student_tail(sigmas, np.where(inside > around, few, _SQUARE_DEGREES))
    inner, border = np.zeros_like(used), edge // 2
    inner[border:-border, border:-border] = used[border:-border, border:-border]
    position = np.unravel_index(int(np.where(inner, shares, np.inf).argmin()), shares.shape)
    others = _elsewhere(np.where(inner, sigmas, 0.0), position, 2 * edge)
    clear = float(sigmas[position]) > _CLEARER * others
    probability = min(1.0, float(shares[position])) if clear else 1.0
    size, (y, x) = float(mean[position]), (int(n) for n in position)
    name = f"a part of {edge} x {edge} px around x {x} y {y}"
    sigma, bounds = sigma_of(size, probability, _SQUARE_DEGREES), {"bounds_px": _bounds(y, x, edge, used.shape)}
    typical = float(np.median(scatter[used]))
    finding = Finding(name, edge**2, size, sigma, _SQUARE_DEGREES, probability, bounds)
    return replace(finding, looks=looks, typical_sigma=typical)


def moved_part(difference: Difference, baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> Finding | None:
    """Square inside which the scene moved most clearly: an object, or one surface's texture.

    The difference is fitted by the slopes of both sides' mean, downwards and to the right, in squares at all positions.
    Products of noise with its own slopes have no sign, whichever side has more of it. A pixel's variance is that of its
    surroundings and a part in proportion to the square of its slope, as samples at random places of a pixel have. What
    the fit leaves in a square enlarges it. Denoisers move edges of few samples as a whole. Where noise is correlated,
    squares elsewhere that are at least as steep show how far, and few of them show little.

    Parameters
    ----------
    difference
        The difference.
    baseline, candidate
        (y, x) pictures with their outliers, summed over wavelengths.

    Returns
    -------
    Finding or None
        The size is the distance in px, to first order. None for small pictures.
    """
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    if min(used.shape) < _LEAST_PX or not used.any():
        return None
    half, total = 0.5 * (baseline + candidate), candidate - baseline
    slopes = np.stack(np.gradient(gaussian_filter(half, _SLOPE_PX, mode="nearest")))
    steepness = (slopes**2).sum(axis=0)
    level = np.maximum(half, _LEAST_LEVEL * float(np.median(half[used])) + 1e-300)
    around = median_filter((total / level) ** 2, _AROUND_PX, mode="reflect") / _MEDIAN_OF_SQUARE
    around = np.maximum(around, _LEAST_SCATTER**2 * float(np.median(around[used])) + _PRECISION**2) * level**2
    steep = used & (steepness / around >= float(np.quantile((steepness / around)[used], 1 - _STEEPEST)))
    steep &= steepness > 1e-20 * float(steepness.max())  # of another scale there are pixels without slopes
    at_slopes = (total**2 / _MEDIAN_OF_SQUARE - around)[steep] / steepness[steep]
    scatter = np.sqrt(around + max(0.0, float(np.median(at_slopes)) if steep.any() else 0.0) * steepness)
    # a firefly counts little, on both sides of the fit
    scatter = np.maximum(scatter, 1e-300)
    weight = np.where(used, 1 / np.maximum(scatter, np.abs(total) / _SLOPE_CUT), 0.0)
    values, shapes = weight * total, weight * slopes
    looks = sum(float(used.sum()) / (edge / 2) ** 2 for edge in _MOVED_PX)
    findings = [
        _moved_square(values, shapes, used, edge, difference.clustering, looks)
        for edge in _MOVED_PX
        if min(used.shape) > edge
    ]
    return min(findings, key=lambda finding: finding.probability, default=None)


def _moved_square(
    values: NDArray[np.float64],
    shapes: NDArray[np.float64],
    used: NDArray[np.bool_],
    edge: int,
    clustering: float,
    looks: float,
) -> Finding:
    """Clearest square of one size in which slopes explain the difference.

    values : (y, x) difference over its scatter. shapes : (2, y, x) slopes downwards and to the right, over the same.
    clustering : number of pixels that correlation makes one.
    """

    def summed(picture: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(uniform_filter(picture, edge, mode="constant") * edge**2)

    y, x = shapes
    steepness = y**2 + x**2
    yy, xx, yx, vy, vx = (summed(p) for p in (y * y, x * x, y * x, values * y, values * x))
    least = _ONE_DIRECTION * (yy + xx) + 1e-30
    yy, xx = yy + least, xx + least
    determinant = yy * xx - yx**2
    down, right = (xx * vy - yx * vx) / determinant, (yy * vx - yx * vy) / determinant
    square = (down * vy + right * vx) / clustering
    # squares of what the fit leaves, weighted as the slopes are
    left = summed(steepness * values**2) - 2 * (
        down * summed(steepness * values * y) + right * summed(steepness * values * x)
    )
    left += down**2 * summed(steepness * y * y) + right**2 * summed(steepness * x * x)
    left += 2 * down * right * summed(steepness * y * x)
    trace = summed(steepness)
    # moving sums leave rounding where there are no slopes, of either sign
    with_slopes = trace > _ROUNDING * float(trace.max())
    squares = np.maximum(summed(steepness**2), trace**2 / edge**2)
    count = np.divide(trace**2, squares, out=np.zeros_like(trace), where=with_slopes) / clustering
    excess = np.divide(left, trace, out=np.zeros_like(left), where=with_slopes) * count / np.maximum(count - 2, 1.0)
    clear = np.where(used & (count >= _LEAST_SLOPES), np.sqrt(np.maximum(square, 0.0) / np.maximum(excess, 1.0)), 0.0)
    position = np.unravel_index(int(clear.argmax()), clear.shape)
    peak, degrees = float(clear[position]), float(np.clip(count[position] - 2, _LEAST_DEGREES, _MOST_OF_SLOPES))
    alike = _without(np.where(trace >= trace[position], clear, 0.0), position, 2 * edge)
    alike = alike[alike > 0]
    spread = max(1.0, float(np.median(alike**2)) / _MEDIAN_OF_TWO) if alike.size else 1.0
    if clustering > 1:
        degrees = min(degrees, 2 * alike.size / edge**2)
    clearer = peak > _CLEARER * _elsewhere(clear, position, 2 * edge) and degrees > 0
    probability = min(1.0, looks * float(fisher_tail(peak**2 / 2 / spread, 2, degrees))) if clearer else 1.0
    size, (row, column) = float(np.hypot(down[position], right[position])), (int(n) for n in position)
    name = f"something moved in {edge} x {edge} px around x {column} y {row}"
    sigma, bounds = sigma_of(size, probability, degrees), {"bounds_px": _bounds(row, column, edge, used.shape)}
    steep = used & (count >= _LEAST_SLOPES)
    # in squares weighted by their slopes: along edges, where a motion shows
    typical = float(np.sqrt(2 * clustering * trace[steep].sum() / (trace[steep] ** 2).sum())) if steep.any() else np.inf
    return Finding(name, edge**2, size, sigma, max(degrees, 1.0), probability, bounds, "px", looks, typical)


def _bounds(row: int, column: int, edge: int, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """First column and row of a square around a pixel, and one after the last ones."""
    top, left = max(row - edge // 2, 0), max(column - edge // 2, 0)
    return left, top, min(column + edge // 2 + 1, shape[1]), min(row + edge // 2 + 1, shape[0])


def _elsewhere(sigmas: NDArray[np.float64], position: tuple[np.intp, ...], reach: int) -> float:
    """Clearest square elsewhere but for some, which may be changes, too."""
    for _ in range(_OTHERS):
        sigmas = _without(sigmas, position, reach)
        position = np.unravel_index(int(sigmas.argmax()), sigmas.shape)
    return float(sigmas[position])


def _without(sigmas: NDArray[np.float64], position: tuple[np.intp, ...], reach: int) -> NDArray[np.float64]:
    """(y, x) sigmas, 0 around a position."""
    y, x = position
    rest = sigmas.copy()
    rest[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1] = 0.0
    return rest
