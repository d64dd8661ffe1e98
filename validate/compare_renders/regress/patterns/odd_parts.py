"""Odd rows, columns and tiles, and steps at the edges of tiles.

Each line or tile is compared with its neighbours, and the result with the scatter of all such comparisons. Noise that
is correlated from pixel to pixel enters both alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import robust_sigma, student_quantile, student_tail
from numpy.typing import NDArray

from .difference import Difference, Finding, self_normalised, sigma_of

__all__ = ["fixed_lines", "odd_lines", "odd_tiles", "tile_steps"]

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
#: Scatters at which the mean of a line is cut: a firefly is in one cube.
_CUT = 4.0
#: Neighbouring lines that count as one: the difference from both neighbours correlates by -2/3 and 1/6, and products of
#: two such by the squares, 1 + 2 (4/9 + 1/36).
_LINES_ALIKE = 1.94


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


def fixed_lines(difference: Difference, apart: NDArray[np.float64]) -> Finding | None:
    """Rows or columns of another brightness each, alike in all cubes.

    Each line is compared with its two neighbours, in either half of the cubes. Noise of the halves is independent, so
    that only a fixed pattern correlates.

    Parameters
    ----------
    difference
        The difference.
    apart
        (n, g, y, x) candidate less baseline of independent cubes, in groups of bands.

    Returns
    -------
    Finding or None
        The clearer of rows and columns, by Pearson's correlation of the halves; None for a single cube or few lines.
    """
    if len(apart) < 2:
        return None
    level = np.where(difference.smooth, difference.level, 0.0)
    halves = [np.where(difference.smooth, apart[i::2].mean(axis=0).sum(axis=0), 0.0) for i in (0, 1)]
    findings = []
    for axis, name in ((1, "rows"), (0, "columns")):
        light, pixels = level.sum(axis=axis), difference.smooth.sum(axis=axis)
        bright = (pixels >= _MIN_PIXELS) & (light > 0)
        means = np.where(bright, np.sum(halves, axis=axis + 1) / np.where(bright, light, 1), np.nan)
        off = means[:, 1:-1] - (means[:, :-2] + means[:, 2:]) / 2
        off = off[:, np.isfinite(off).all(axis=0)]
        degrees = off.shape[1] / _LINES_ALIKE - 2
        scatter = np.array([[robust_sigma(part)] for part in off])
        if degrees * _LINES_ALIKE < _MIN_PARTS or not scatter.all():
            continue
        off = np.clip(off, -_CUT * scatter, _CUT * scatter)
        alike = float(np.clip(np.asarray(np.corrcoef(off))[0, 1], 0, 1 - 1e-12))
        statistic = alike * np.sqrt(degrees / (1 - alike**2))
        probability = min(1.0, 2 * float(student_tail(statistic, degrees)))
        size = float(np.sqrt(max(float(np.mean(off[0] * off[1])), 0.0) / 1.5))
        findings.append((probability, f"a fixed pattern of {name}", int(pixels[bright].sum()), size, degrees))
    if not findings:
        return None
    probability, name, pixels_used, size, degrees = min(findings)
    return Finding(name, pixels_used, size, sigma_of(size, probability, degrees), degrees, probability)


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
        # a part that a filter left flat does not show its noise
        sigmas = np.abs(off[used]) / np.sqrt(np.maximum(allowed[used], np.median(allowed[used])))
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
