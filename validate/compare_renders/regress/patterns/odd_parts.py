"""Odd rows, columns, tiles and small parts, and steps at the edges of tiles.

Each line or tile is compared with its neighbours, and the result with the scatter of all such comparisons. Noise that
is correlated from pixel to pixel enters both alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import fisher_tail, student_quantile, student_tail
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter, uniform_filter

from .difference import Difference, Finding, self_normalised, sigma_of

__all__ = ["moved_part", "odd_lines", "odd_tiles", "small_part", "tile_steps"]

#: Edges of tiles, px.
_TILES_PX = (4, 8, 16, 32)
#: Edges of tiles at whose edges steps are looked for, px.
_STEPS_PX = (4, 6, 8, 10, 12, 16, 20, 24, 32, 40, 64)
#: Fewest smooth pixels of a line or a tile.
_MIN_PIXELS = 12
#: Part of a tile's pixels that have to be smooth.
_MIN_SMOOTH_PART = 0.75
#: Most degrees of freedom: sums of a few pixels are not normal.
_MAX_DEGREES = 12.0
#: Fewest lines or tiles of a test.
_MIN_PARTS = 12
#: Widest strip on each side of a step, px.
_STRIP_PX = 3
#: Longest part of a step, px: short parts find more places in small pictures.
_LENGTH_PX = 4
#: Fewest steps of a test.
_MIN_STEPS = 16
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
#: Squares elsewhere that may have changed, too.
_OTHERS = 2
#: Factor by which a finding has to be clearer than all others: a denoiser's noisy spots are about alike.
_CLEARER = 2.0
#: Pixels a side of the smallest picture.
_LEAST_PX = 24
#: Edges of the squares in which something may have moved, px: an object with the surroundings that it uncovers.
_MOVED_PX = (7, 11, 15)
#: Pixels that correlation makes one, above which noise along an edge is alike, too.
_MOST_ALIKE = 1.25
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
#: Fewest pixels that slopes weight alike in a square.
_LEAST_SLOPES = 6.0


@dataclass(frozen=True, eq=False)
class _Parts:
    """Lines or tiles of one kind."""

    #: Name of the kind.
    name: str
    #: (n,) mean of each part less that of its neighbours; NaN for few pixels.
    off: NDArray[np.float64]
    #: (n,) variance of ``off`` by the scatter inside.
    variance: NDArray[np.float64]
    #: (n,) smooth pixels of each part.
    pixels: NDArray[np.int64]


def odd_lines(difference: Difference) -> Finding | None:
    """Row or column that differs most from its neighbours.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The finding; None for small pictures.
    """
    tests = []
    for axis, name in ((1, "row"), (0, "column")):
        counts = difference.smooth.sum(axis=axis)
        sums = difference.relative.sum(axis=axis)
        squares = (difference.relative**2).sum(axis=axis)
        mean, noise = _means(counts, sums, squares)
        neighbours = np.stack([np.r_[np.nan, mean[:-1]], np.r_[mean[1:], np.nan]])
        both = np.stack([np.r_[np.nan, noise[:-1]], np.r_[noise[1:], np.nan]])
        off = mean - neighbours.mean(axis=0)
        tests.append(_Parts(name, off, noise + both.sum(axis=0) / 4, counts))
    return _most_odd(tests, lambda name, index: f"one {name}: {name} {index + 1}")


def odd_tiles(difference: Difference) -> Finding | None:
    """Tile that differs most from the tiles around it.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The finding; None for small pictures.
    """
    tests = []
    for edge in _TILES_PX:
        height, width = (size // edge for size in difference.level.shape)
        if min(height, width) < 3:
            continue
        counts, sums, squares = (
            picture[: height * edge, : width * edge].reshape(height, edge, width, edge).sum(axis=(1, 3))
            for picture in (difference.smooth, difference.relative, difference.relative**2)
        )
        mean, noise = _means(np.where(counts >= _MIN_SMOOTH_PART * edge**2, counts, 0), sums, squares)
        around, of_around = (_around(values) for values in (mean, noise))
        few = np.isfinite(around).sum(axis=0)
        with np.errstate(invalid="ignore"):
            neighbours = np.where(few >= 2, np.nansum(around, axis=0) / np.maximum(few, 1), np.nan)
            allowed = noise + np.nansum(of_around, axis=0) / np.maximum(few, 1) ** 2
        name = f"one tile of {edge} px"
        tests.append(_Parts(name, (mean - neighbours).ravel(), allowed.ravel(), counts.ravel()))
    across = {f"one tile of {edge} px": difference.level.shape[1] // edge for edge in _TILES_PX}

    def label(name: str, index: int) -> str:
        row, column = divmod(index, across[name])
        return f"{name}: row {row + 1}, column {column + 1} of tiles"

    return _most_odd(tests, label)


def tile_steps(difference: Difference) -> Finding | None:
    """Tiles that differ by factors, by larger steps at their edges than inside.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    Finding or None
        The clearest edge of tiles; None for small pictures.
    """
    tests = []
    for edge in _STEPS_PX:
        along_x = _steps(difference.relative, difference.smooth, edge)
        along_y = _steps(difference.relative.T, difference.smooth.T, edge)
        terms, sizes = (np.concatenate(pair) for pair in zip(along_x, along_y, strict=True))
        if terms.size >= _MIN_STEPS:
            statistic, probability = self_normalised(terms)
            tests.append((probability if statistic > 0 else 1.0, edge, terms.size, float(np.sqrt(np.mean(sizes**2)))))
    if not tests:
        return None
    probability, edge, count, size = min(tests)
    share = min(1.0, len(tests) * probability)
    student = float(student_quantile(max(share, 1e-300) / 2, count - 1))
    return Finding(
        f"tiles of {edge} px",
        int(difference.smooth.sum()),
        size,
        size / max(student, 1e-12),
        count - 1.0,
        share,
        {"edge_px": edge},
    )


def _means(counts: NDArray, sums: NDArray, squares: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means of parts and their variances by the scatter inside; NaN for few pixels."""
    enough = counts >= _MIN_PIXELS
    pixels = np.maximum(counts, 1)
    mean = np.where(enough, sums / pixels, np.nan)
    noise = np.where(enough, np.maximum(squares / pixels - (sums / pixels) ** 2, 0.0) / pixels, np.nan)
    return mean, noise


def _around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, y, x) neighbours along rows and columns; NaN outside."""
    wide = np.pad(values, 1, constant_values=np.nan)
    return np.stack([wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]])


def _most_odd(tests: Sequence[_Parts], label: Callable[[str, int], str]) -> Finding | None:
    """Part whose distance from its neighbours is the largest among comparable parts."""
    clearest, looks = [], 0
    for parts in tests:
        off, allowed = parts.off, parts.variance
        used = np.isfinite(off) & (allowed > 0)
        number = int(used.sum())
        if number < _MIN_PARTS:
            continue
        looks += number
        sigmas = np.abs(off[used]) / np.sqrt(allowed[used])
        # each part against all others, at least as noisy as its pixels are
        square = sigmas**2
        others = np.maximum((square.sum() - square) / (number - 1), 1.0)
        statistic = sigmas / np.sqrt(others)
        best = int(np.argmax(statistic))
        index = int(np.flatnonzero(used)[best])
        degrees = min(_MAX_DEGREES, number - 1.0)
        probability = float(2 * student_tail(statistic[best], degrees))
        figures = float(off[index]), float(statistic[best]), degrees, int(parts.pixels[index])
        clearest.append((probability, label(parts.name, index), *figures))
    if not clearest:
        return None
    probability, name, size, statistic, degrees, pixels = min(clearest)
    return Finding(name, pixels, size, abs(size) / max(statistic, 1e-12), degrees, min(1.0, looks * probability))


def _steps(
    relative: NDArray[np.float64], smooth: NDArray[np.bool_], edge: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared steps at edges of tiles less those in their middles, and the former."""
    strip, length = min(edge // 2, _STRIP_PX), min(edge, _LENGTH_PX)
    height, width = relative.shape
    rows = height // length
    if not rows:
        return np.zeros(0), np.zeros(0)
    cut = [picture[: rows * length].reshape(rows, length, width).mean(axis=1) for picture in (relative, smooth)]
    values, inside = (np.pad(np.cumsum(picture, axis=1), ((0, 0), (1, 0))) for picture in cut)
    at = np.arange(edge, width - edge + 1, edge)
    if at.size < 1:
        return np.zeros(0), np.zeros(0)

    def step(columns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        right, middle, left = (columns + shift for shift in (strip, 0, -strip))
        size = (values[:, right] - 2 * values[:, middle] + values[:, left]) / strip
        return size, inside[:, right] - inside[:, left] > 2 * strip - 1e-9

    ends, ends_inside = step(at)
    middles, middles_inside = step(at - edge // 2)
    both = ends_inside & middles_inside
    return (ends**2 - middles**2)[both], ends[both]


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
    relative = (candidate - baseline) / np.maximum(half, _LEAST_LEVEL * float(np.median(half[used])) + 1e-300)
    off = relative - median_filter(relative, _AROUND_PX, mode="reflect")
    around = median_filter(off**2, _AROUND_PX, mode="reflect") / _MEDIAN_OF_SQUARE
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
    sigmas = np.abs(mean) / np.sqrt(np.maximum(inside, around) / independent)
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
    return Finding(name, edge**2, size, sigma, _SQUARE_DEGREES, probability, bounds)


def moved_part(difference: Difference, baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> Finding | None:
    """Square inside which the scene moved most clearly: an object, or one surface's texture.

    The difference is fitted by the slopes of both sides' mean, downwards and to the right, in squares at all positions.
    Products of noise with its own slopes have no sign, whichever side has more of it. A pixel's variance is that of its
    surroundings and a part in proportion to the square of its slope, as samples at random places of a pixel have. What
    the fit leaves in a square enlarges it.

    Parameters
    ----------
    difference
        The difference.
    baseline, candidate
        (y, x) pictures with their outliers, summed over wavelengths.

    Returns
    -------
    Finding or None
        The size is the distance in px, to first order. None for small pictures, and for noise that makes neighbours
        alike: denoisers move edges of few samples as a whole.
    """
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    alike = difference.clustering > _MOST_ALIKE or not difference.of_pixel_filter
    if min(used.shape) < _LEAST_PX or not used.any() or alike:
        return None
    half, total = 0.5 * (baseline + candidate), candidate - baseline
    slopes = np.stack(np.gradient(gaussian_filter(half, _SLOPE_PX, mode="nearest")))
    steepness = (slopes**2).sum(axis=0)
    level = np.maximum(half, _LEAST_LEVEL * float(np.median(half[used])) + 1e-300)
    around = median_filter((total / level) ** 2, _AROUND_PX, mode="reflect") / _MEDIAN_OF_SQUARE
    around = np.maximum(around, _LEAST_SCATTER**2 * float(np.median(around[used])) + 1e-300) * level**2
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
    count = trace**2 / np.maximum(summed(steepness**2), 1e-300) / clustering
    excess = np.divide(left, trace, out=np.zeros_like(left), where=trace > 0) * count / np.maximum(count - 2, 1.0)
    clear = np.where(used & (count >= _LEAST_SLOPES), np.sqrt(np.maximum(square, 0.0) / np.maximum(excess, 1.0)), 0.0)
    position = np.unravel_index(int(clear.argmax()), clear.shape)
    peak, degrees = float(clear[position]), float(np.clip(count[position] - 2, _LEAST_DEGREES, _MOST_OF_SLOPES))
    others = _elsewhere(clear, position, 2 * edge)
    probability = min(1.0, looks * float(fisher_tail(peak**2 / 2, 2, degrees))) if peak > _CLEARER * others else 1.0
    size, (row, column) = float(np.hypot(down[position], right[position])), (int(n) for n in position)
    name = f"something moved in {edge} x {edge} px around x {column} y {row}"
    sigma, bounds = sigma_of(size, probability, degrees), {"bounds_px": _bounds(row, column, edge, used.shape)}
    return Finding(name, edge**2, size, sigma, degrees, probability, bounds, "px")


def _bounds(row: int, column: int, edge: int, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """First column and row of a square around a pixel, and one after the last ones."""
    top, left = max(row - edge // 2, 0), max(column - edge // 2, 0)
    return left, top, min(column + edge // 2 + 1, shape[1]), min(row + edge // 2 + 1, shape[0])


def _elsewhere(sigmas: NDArray[np.float64], position: tuple[np.intp, ...], reach: int) -> float:
    """Clearest square elsewhere but for some, which may be changes, too."""
    rest = sigmas.copy()
    for _ in range(_OTHERS):
        y, x = position
        rest[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1] = 0.0
        position = np.unravel_index(int(rest.argmax()), rest.shape)
    return float(rest[position])
