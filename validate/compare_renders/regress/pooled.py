"""Tests of pooled means: ratios of sums over pixels, as Student's t.

The rate of false alarms of the verdict is divided among kinds of pools beforehand, most of it to the entire picture.
Within a kind the shares are equal (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from cboxlab.rendering.image import high_pass
from cboxlab.utils.distributions import normal_quantile, student_quantile, student_tail
from numpy.typing import NDArray
from scipy.ndimage import laplace, maximum_filter, median_filter, minimum_filter

from .grids import Sums, band_contrasts
from .noise import Noise, smooth_variance
from .outliers import Trimmed
from .patterns import (
    POWER,
    SHARES,
    Difference,
    PooledMean,
    block_spread,
    mirror_order,
    pool_of_finding,
    scatter_of_blocks,
    steady_sigmas,
    sum_by_blocks,
)
from .strata import BLOCKS, Strata

__all__ = ["SHARES", "SYSTEMATIC", "PooledMean", "Pooling", "area_means", "difference_of", "pooled_means"]

#: Relative standard deviation that is added to any pooled mean: the accuracy of the estimators themselves.
SYSTEMATIC = 1.0e-4

#: The same for sides with the same random numbers: single precision of files.
SYSTEMATIC_PAIRED = 3.0e-6

#: Relative standard deviation that is added to any cell.
_CELL_FLOOR = 1e-3
#: Largest weight of a cell over the median weight: no cell rules the mean.
_MAX_CELL_WEIGHT = 20.0
#: Fewest pixels of a pool, and fewest cells of the even test.
_MIN_PIXELS = 12
#: Fewest pixels of a pool over the number that correlation makes one.
_MIN_INDEPENDENT = 6.0
#: Most degrees of freedom of blocks and strata: small pools of skewed noise are not normal.
_MAX_BLOCK_DEGREES = 12.0
#: Kinds of pools of few pixels.
_SMALL_POOLS = ("block", "colour", "stratum")
#: Kinds of pools of the entire picture.
_WIDE_POOLS = ("whole", "band")
#: Steps of this many standard deviations count half in patterns, larger ones more.
_CLEAR_STEP_SIGMAS = 10.0
#: Second derivative over the step of an edge, below which the edge is too wide to show a blur.
_SHARP_EDGE = 0.2
#: Fourth powers over the squared sum of squares, below which single pixels rule a pattern: ten equal pixels.
_MIN_PATTERN_PIXELS = 10
#: Groups of edges in which patterns are tested: all, and those of the lamp.
_PATTERN_GROUPS = 2
#: Squares count at most this many times their median in a mean: 30 cuts outliers and leaves normal noise alone.
_SQUARE_CUT = 30

#: (y, x) picture of a (y, x, w) cube.
_PictureOf = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Pooling:
    """Data that all pools share."""

    #: Difference and baseline without outliers.
    trimmed: Trimmed
    #: Noise of the difference.
    noise: Noise
    #: Parts of the picture.
    strata: Strata
    #: Rate of false alarms of the verdict.
    false_alarms: float
    #: (w,) relative standard deviation from differing wavelength grids.
    interpolation: NDArray[np.float64]
    #: Weight of the candidate, 0 to 1, in the mean of both pictures whose noise is independent of their difference's.
    quieter: float = 0.5
    #: (y, x) variance of each pixel relative to other pixels, for weights; None for that of ``noise``.
    roughness: NDArray[np.float64] | None = None
    #: (y, x, w) standard deviation that pixels have in common, from the steps of files; None for 0.
    shared: NDArray[np.float64] | None = None
    #: Relative standard deviation of single pixels from the steps of files, their median; 0 for fine steps.
    rounding: float = 0.0
    #: Whether both sides have the same random numbers, so that errors of estimators cancel.
    paired: bool = False

    @property
    def systematic(self) -> float:
        """Relative standard deviation that is added to any pooled mean."""
        return SYSTEMATIC_PAIRED if self.paired else SYSTEMATIC

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.trimmed.level.shape[-1]

    @cached_property
    def level(self) -> NDArray[np.float64]:
        """(y, x) baseline summed over wavelengths."""
        return np.asarray(self.trimmed.level.sum(axis=-1))

    @cached_property
    def total(self) -> NDArray[np.float64]:
        """(y, x) difference summed over wavelengths."""
        return np.asarray(self.trimmed.difference.sum(axis=-1))

    @property
    def common_step(self) -> float:
        """Relative standard deviation that pixels share, from the steps of files; 0 for fine steps."""
        return 0.0 if self.shared is None else float(self.shared.sum()) / max(float(self.level.sum()), 1e-300)

    @cached_property
    def summed(self) -> Sums:
        """Sums over all wavelengths."""
        all_bands = np.ones(self.bands)
        allowed = float(np.mean(self.interpolation))
        return self._sums(lambda cube: cube @ all_bands, self.noise.total, allowed, 1.0)

    def band(self, number: int) -> Sums:
        """Pictures of one band, in time that does not depend on the number of bands.

        Parameters
        ----------
        number
            Number of the band.

        Returns
        -------
        Sums
            Its pictures.
        """
        allowed = float(self.interpolation[number])
        variance = self.noise.of_band(number)
        return self._sums(lambda cube: np.ascontiguousarray(cube[..., number]), variance, allowed, 1.0 / self.bands)

    def contrast(self, weights: NDArray[np.float64]) -> Sums:
        """Pictures of a difference of bands, over the light of all bands.

        The noise of the sum stands for that of the difference, unless neighbours scatter more.

        Parameters
        ----------
        weights
            (w,) weights of the bands, -1 to 1.

        Returns
        -------
        Sums
            Its pictures.
        """
        allowed = float(np.mean(self.interpolation))
        return replace(self._sums(lambda cube: cube @ weights, self.noise.total, allowed, 1.0), level=self.level)

    def _sums(self, picture_of: _PictureOf, variance: NDArray[np.float64], allowed: float, part: float) -> Sums:
        """Pictures that ``picture_of`` takes from (y, x, w) cubes."""
        difference = picture_of(self.trimmed.difference)
        shared = None if self.shared is None else picture_of(self.shared)
        level = picture_of(self.trimmed.level)
        return Sums(level, difference, variance, shared, allowed, part, high_pass(difference))


def area_means(pooling: Pooling) -> tuple[PooledMean, ...]:
    """Tests of the sums over wavelengths in each area of the picture.

    Parameters
    ----------
    pooling
        Difference, noise and parts of the picture.

    Returns
    -------
    tuple of PooledMean
        The entire picture, surfaces, edges, border and lamp. Areas with too few pixels or without light are left out.
    """
    strata, summed, surfaces = pooling.strata, pooling.summed, pooling.strata.surfaces
    parts = {"edges": strata.edges, "border": strata.border, "lamp": strata.lamp & strata.used}
    pools = [
        _pool_of(pooling, summed, "whole", "whole picture", strata.body, 1),
        *(_pool_of(pooling, summed, "surface", n, mask, len(surfaces)) for n, mask in surfaces.items()),
        *(_pool_of(pooling, summed, "stratum", n, mask, len(parts)) for n, mask in parts.items()),
    ]
    return tuple(row for row in pools if row is not None)


def pooled_means(pooling: Pooling, band_names: Sequence[str]) -> tuple[PooledMean, ...]:
    """Tests of all pools.

    The pools are the entire picture (plain, and by the precision of its cells), each surface, each band, and patterns.
    There are pools of edges, border and lamp, too, and a grid of blocks with their colours, spread and order.

    Parameters
    ----------
    pooling
        Difference, noise and parts of the picture.
    band_names
        Names of the bands.

    Returns
    -------
    tuple of PooledMean
        The entire picture first. Pools with too few pixels or without light are left out.
    """
    strata, summed, bands, areas = pooling.strata, pooling.summed, len(band_names), area_means(pooling)
    by_band = [_pool_of(pooling, pooling.band(i), "band", n, strata.body, bands) for i, n in enumerate(band_names)]
    tested = _blocks(pooling, summed, "block", "", 1)
    contrasts = band_contrasts(band_names)
    for name, weights in contrasts.items():
        tested += _blocks(pooling, pooling.contrast(weights), "colour", f", {name}", len(contrasts))
    level, change = pooling.trimmed.level, pooling.trimmed.difference
    of_light = [row for row in tested if row.kind == "block"]
    findings = {"spread": block_spread(of_light, pooling.noise.clustering), "order": mirror_order(level, change)}
    return (
        *(row for row in areas if row.kind != "stratum"),
        *(row for row in by_band if row is not None),
        *(row for row in areas if row.kind == "stratum"),
        *tested,
        *(pool_of_finding(k, f, pooling.false_alarms * SHARES[k]) for k, f in findings.items() if f is not None),
        *_even(pooling),
        *_patterns(pooling, strata.edges | strata.lamp, ""),
        *_patterns(pooling, strata.lamp, "lamp "),
    )


def difference_of(pooling: Pooling) -> Difference:
    """Difference as tests of patterns take it.

    Parameters
    ----------
    pooling
        Difference, noise and parts of the picture.

    Returns
    -------
    Difference
        The difference.
    """
    strata = pooling.strata
    groups = {"smooth parts": strata.smooth, "edges": strata.edges, "the lamp": strata.lamp & strata.used}
    variance = None if pooling.noise.estimated else pooling.noise.total
    return Difference(pooling.level, pooling.total, variance, strata.smooth, groups, pooling.noise.clustering)


def _pool_of(
    pooling: Pooling, sums: Sums, kind: str, name: str, mask: NDArray[np.bool_], count: int
) -> PooledMean | None:
    """Test of one of ``count`` pools of a kind; None for too few pixels or no light."""
    trimmed, noise = pooling.trimmed, pooling.noise
    level, pixels = float(sums.level[mask].sum()), int(mask.sum())
    independent = pixels / noise.clustering
    few = independent < _MIN_INDEPENDENT and kind != "whole"
    if pixels < _MIN_PIXELS or few or level <= 0:
        return None
    difference, each = float(sums.difference[mask].sum()), sums.variance[mask]
    quiet = np.where(trimmed.outlier[mask], np.median(each), each)
    noise_sum = float(quiet.sum())
    variance = max(noise_sum, _scatter(pooling, sums, kind, mask, difference / level)) * noise.clustering
    by_blocks, blocks = 0.0, np.inf
    if kind in _WIDE_POOLS and noise.filtered:
        block, alike = pooling.strata.block, 1 + noise.clustering * BLOCKS**2 / mask.size
        by_blocks, blocks = scatter_of_blocks(sums.difference[mask], sums.level[mask], block[mask], alike)
    # light set aside as outliers may belong to the picture: up to each pixel's own radiance it counts as uncertain
    bound = pooling.level[mask]
    aside = float(np.clip(trimmed.excess[mask], -bound, bound).sum()) * sums.part
    variance += aside**2 + (pooling.systematic * level) ** 2 + (sums.interpolation * level) ** 2
    if sums.shared is not None:
        variance += float(sums.shared[mask].sum()) ** 2
    degrees = max(2.0, min(noise_sum**2 / max(float((quiet**2).sum()) / noise.degrees, 1e-300), independent - 1.0))
    degrees = min(degrees, _MAX_BLOCK_DEGREES) if kind in _SMALL_POOLS else degrees
    if by_blocks > variance:
        variance, degrees = by_blocks, min(degrees, blocks)
    return _row(
        pooling,
        kind,
        name,
        pixels,
        difference=difference / level,
        sigma=float(np.sqrt(variance)) / level,
        degrees=degrees,
        count=count,
    )


def _blocks(pooling: Pooling, sums: Sums, kind: str, suffix: str, grids: int) -> list[PooledMean]:
    """Tests of a grid of blocks, one of ``grids`` of its kind."""
    strata, rows = pooling.strata, []
    for i in range(BLOCKS**2):
        name = f"row {i // BLOCKS + 1}, column {i % BLOCKS + 1}{suffix}"
        mask = strata.smooth & (strata.block == i)
        rows.append(_pool_of(pooling, sums, kind, name, mask, grids * BLOCKS**2))
    return _steadied(pooling, [row for row in rows if row is not None], grids)


def _steadied(pooling: Pooling, blocks: list[PooledMean], grids: int) -> list[PooledMean]:
    """Blocks whose standard deviations fit those of all blocks, where noise is estimated."""
    if not pooling.noise.estimated or len(blocks) < _MIN_PIXELS:
        return blocks
    differences, sigmas = (np.array([getattr(block, key) for block in blocks]) for key in ("difference", "sigma"))
    steady = steady_sigmas(differences, sigmas, _MAX_BLOCK_DEGREES, alike=pooling.noise.clustering > 1)
    row = partial(_row, pooling, count=grids * BLOCKS**2)
    return [
        row(b.kind, b.name, b.pixels, difference=b.difference, sigma=float(s), degrees=b.degrees)
        for b, s in zip(blocks, steady, strict=True)
    ]


def _even(pooling: Pooling) -> list[PooledMean]:
    """Test of the mean of the cells' relative differences, each weighted by its precision.

    It is the sharpest test of a change by about the same factor everywhere, as of a paint or of the depth of paths.
    Cells are surfaces, edges and border, in each block of the grid.
    """
    strata, noise, trimmed = pooling.strata, pooling.noise, pooling.trimmed
    part = np.zeros(strata.block.shape, int)
    for number, mask in enumerate((strata.edges, strata.border, *strata.surfaces.values()), start=1):
        part[mask] = number
    body = strata.body
    kinds, cell, pixels = np.unique((part * BLOCKS**2 + strata.block)[body], return_inverse=True, return_counts=True)
    outlier, each = trimmed.outlier[body], noise.total[body]
    quiet = np.where(outlier, np.median(each), each)
    bound = pooling.level[body]
    aside = np.clip(trimmed.excess[body], -bound, bound)
    rough = each if pooling.roughness is None else pooling.roughness[body]
    rough = np.where(outlier, np.median(rough), rough)
    total = pooling.total[body]
    scatter = (total - bound * (total.sum() / max(float(bound.sum()), 1e-300))) ** 2
    shared = 0 * total if pooling.shared is None else pooling.shared[body].sum(axis=-1)
    by_pixel = (bound, total, quiet, scatter, aside, rough, shared)
    used = (pixels >= _MIN_PIXELS) & (np.bincount(cell, bound) > 0)
    level, difference, expected, about, excess, unrest, common = (np.bincount(cell, v)[used] for v in by_pixel)
    independent = float(pixels[used].sum()) / noise.clustering
    if level.size < _MIN_PIXELS or independent < 2 * _MIN_INDEPENDENT:
        return []
    inflation = noise.clustering * (max(1.0, noise.ratio) if np.isfinite(noise.ratio) else 1.0)
    floor = (_CELL_FLOOR * pooling.systematic / SYSTEMATIC * level) ** 2
    variance = np.maximum(inflation * expected, noise.clustering * about) + floor
    weight = level**2 / (unrest * variance.sum() / max(float(unrest.sum()), 1e-300) + floor)  # of relative differences
    weight = np.minimum(weight, _MAX_CELL_WEIGHT * np.median(weight)) / level
    norm_ = float(weight @ level)
    allowed = float(np.hypot(pooling.systematic, np.mean(pooling.interpolation)))
    squares, degrees = float(weight**2 @ variance), min(float(level.size), independent) - 1.0
    if noise.filtered:
        # the scatter inside a cell does not show noise that its pixels share, and few quiet cells may rule the mean
        alike = 1 + noise.clustering * BLOCKS**2 / float(pixels[used].sum())
        block = kinds[used] % BLOCKS**2
        by_blocks, count = scatter_of_blocks(weight * difference, weight * level, block, alike)
        if by_blocks > squares:
            squares, degrees = by_blocks, min(degrees, count)
    sigma = np.sqrt(squares + float(weight @ excess) ** 2 + float(weight @ common) ** 2) / norm_
    return [
        _row(
            pooling,
            "even",
            "weighted by precision",
            int(pixels[used].sum()),
            difference=float(weight @ difference) / norm_,
            sigma=float(np.hypot(sigma, allowed)),
            degrees=degrees,
            count=1,
        )
    ]


def _scatter(pooling: Pooling, sums: Sums, kind: str, mask: NDArray[np.bool_], mean: float) -> float:
    """Variance of a pool's sum by the scatter of the pool's pixels.

    Their squares about the mean bound the effect of a single pixel: a firefly that is not set aside raises no alarm.
    """
    about = float((((sums.difference - mean * sums.level)[mask]) ** 2).sum())
    about /= 1 - min(pooling.noise.clustering / int(mask.sum()), 1 / _MIN_INDEPENDENT)
    inner = mask & pooling.strata.smooth
    if kind == "stratum" or inner.sum() < _MIN_PIXELS:
        return about
    squares = sums.fine[inner] ** 2
    # second differences are large where a corner of the kernel touches an edge
    return max(about, float(np.minimum(squares, _SQUARE_CUT * np.median(squares)).mean()) * int(mask.sum()))


def _row(
    pooling: Pooling,
    kind: str,
    name: str,
    pixels: int,
    *,
    difference: float,
    sigma: float,
    degrees: float,
    count: int,
    unit: str = "1",
) -> PooledMean:
    """Test of a difference with its share of the false alarms, one of ``count`` of its kind."""
    critical = pooling.false_alarms * SHARES[kind] / count
    statistic = difference / sigma
    threshold = float(student_quantile(critical / 2, degrees))
    return PooledMean(
        kind,
        name,
        pixels,
        difference,
        sigma,
        degrees,
        statistic,
        float(2 * student_tail(abs(statistic), degrees)),
        critical,
        (threshold + float(normal_quantile(1 - POWER))) * sigma,
        unit,
    )


def _patterns(pooling: Pooling, edges: NDArray[np.bool_], prefix: str) -> list[PooledMean]:
    """Tests of patterns at some edges: shift, magnification, turn, blur.

    The part of each side in the noise is estimated, and not well known of few cubes or of a few bright pixels. Each
    test is therefore the less clear of two, by that part and by one half.
    """
    rows = _patterns_by(pooling, edges, prefix, pooling.quieter)
    others = {row.name: row for row in _patterns_by(pooling, edges, prefix, 0.5)}
    return [min(row, others[row.name], key=lambda r: abs(r.statistic)) for row in rows if row.name in others]


def _patterns_by(pooling: Pooling, edges: NDArray[np.bool_], prefix: str, quieter: float) -> list[PooledMean]:
    """The same by slopes of a mean of both pictures, with the candidate's weight ``quieter``.

    Shifts are px, magnification and turn px at half a width from the centre, blur is an added variance in px^2.
    Each edge pixel contributes with its own sign. The sum over its own root sum of squares is the statistic. It needs
    no known variance, and heavy tails make it smaller, not larger.
    """
    strata, trimmed = pooling.strata, pooling.trimmed
    level, total = pooling.level, pooling.total
    # slopes from a mean whose noise is independent of the difference's, or noise would look like sharper edges
    half = level + total * quieter
    quiet = median_filter(half, 3, mode="nearest")
    span = maximum_filter(half, 3) - minimum_filter(half, 3)
    sigma = smooth_variance(quiet, pooling.noise.total, pooling.noise.degrees)
    down, right = (np.asarray(slope) for slope in np.gradient(half))
    curved = -laplace(half, mode="nearest")
    inside = np.pad(np.ones(np.subtract(level.shape, 2), bool), 1)
    at_edges = strata.used & inside & edges
    weight = np.where(at_edges, 1 / np.maximum(span**2 + _CLEAR_STEP_SIGMAS**2 * sigma, 1e-300), 0.0)
    scale = trimmed.difference.sum() / max(float(trimmed.level.sum()), 1e-300)
    residual = total - scale * half
    common = np.asarray(0 * total if pooling.shared is None else pooling.shared.sum(axis=-1))
    y, x = (axis - (axis.max() / 2) for axis in np.indices(level.shape))
    x, y = 2 * x / level.shape[1], 2 * y / level.shape[1]
    patterns: tuple[tuple[str, Any, str, float], ...] = (
        ("shift x", -right, "px", 0.0),
        ("shift y", -down, "px", 0.0),
        ("magnification", -(right * x + down * y), "px", 0.0),
        ("turn", right * y - down * x, "px", 0.0),
        ("blur", -curved / 2, "px^2", _SHARP_EDGE),
    )
    rows = []
    for name, slope, unit, sharpness in patterns:
        used = at_edges & (np.abs(slope) > sharpness * span)
        # neither light that brightens all pixels alike is a pattern, nor the error of ``scale``, which they share
        w, s, light = weight[used], np.asarray(slope)[used], half[used]
        s = s - light * (w * s * light).sum() / max(float((w * light**2).sum()), 1e-300)
        terms, norms = w * s * residual[used], w * s**2
        root = float(np.sqrt((terms**2).sum() * pooling.noise.clustering))
        few = (terms**2).sum() ** 2 < _MIN_PATTERN_PIXELS * (terms**4).sum()
        independent = float(used.sum()) / pooling.noise.clustering
        if used.sum() < 2 * _MIN_PIXELS or independent < _MIN_INDEPENDENT or root == 0 or few:
            continue
        alike = pooling.noise.clustering
        by_blocks, blocks = sum_by_blocks(used, terms, norms, alike) if pooling.noise.filtered else (0.0, np.inf)
        if not np.isfinite(by_blocks):
            continue
        if by_blocks > root:
            root, independent = by_blocks, min(independent, blocks + 1.0)
        rows.append(
            _row(
                pooling,
                "pattern",
                prefix + name,
                int(used.sum()),
                difference=float(terms.sum() / norms.sum()),
                sigma=float(np.hypot(root, (w * s) @ common[used])) / float(norms.sum()),
                degrees=independent - 1.0,
                count=_PATTERN_GROUPS * len(patterns),
                unit=unit,
            )
        )
    return rows
