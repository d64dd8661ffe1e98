"""Tests of pooled means: each a ratio of sums over pixels, over its standard deviation, as Student's t.

The probability of a false alarm that the verdict may have is shared out among kinds of pools beforehand, most of
it to the whole picture; within a kind the shares are equal (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.image import high_pass
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter
from scipy.stats import norm, t

from .noise import Noise, smooth_variance
from .outliers import Trimmed
from .strata import BLOCKS, Strata

__all__ = [
    "SHARES",
    "SYSTEMATIC",
    "PooledMean",
    "Pooling",
    "pool_of",
    "pooled_means",
    "quieter_part",
    "roughness_of",
]

#: Parts of the false-alarm rate.
SHARES = {
    "whole": 0.10,
    "even": 0.35,
    "surface": 0.20,
    "band": 0.10,
    "stratum": 0.05,
    "pattern": 0.08,
    "block": 0.12,
}

#: Relative standard deviation of any pooled mean that no noise explains: the estimators' own accuracy.
SYSTEMATIC = 1.0e-4

#: Relative standard deviation of a cell that no noise explains; cells weigh at most so many times their median.
_CELL_FLOOR, _HEAVIEST = 1e-3, 20.0
#: Fewer pixels make no pool.
_FEWEST = 12
#: Small pools of skewed noise are judged as Student's t with no more degrees of freedom than this.
_BLOCK_DEGREES = 12.0
#: Steps of so many standard deviations count in full in patterns, smaller ones less.
_CLEAR_SIGMAS = 10.0
#: Edges whose second derivative is below this part of their step, times two, do not tell a blur.
_SHARP = 0.2
#: Power is stated for this part of all runs.
_POWER = 0.9


@dataclass(frozen=True)
class PooledMean:
    """One pool. difference : of the means over the baseline's mean (of patterns: of its own unit, see ``unit``).

    sigma : its standard deviation. statistic : their ratio. probability : two-sided, of a statistic this large in
    equal pictures. critical : probability below which this pool alone makes the verdict "different".
    detectable : size of a difference found in 90 of 100 runs like this.
    """

    kind: str
    name: str
    pixels: int
    difference: float
    sigma: float
    degrees: float
    statistic: float
    probability: float
    critical: float
    detectable: float
    unit: str = "1"

    @property
    def different(self) -> bool:
        """Whether this pool alone decides."""
        return self.probability < self.critical


@dataclass(frozen=True, eq=False)
class Pooling:
    """What all pools share. interpolation : (w,) relative standard deviation from differing wavelength grids.

    quieter : candidate's part in the mean of both pictures whose noise is independent of their difference's, 0 to 1.
    roughness : (y, x) how much variance each pixel has beside others, for weights; None for that of ``noise``.
    shared : (y, x, w) standard deviation that pixels have in common, from the steps of files; None for 0.
    """

    trimmed: Trimmed
    noise: Noise
    strata: Strata
    false_alarms: float
    interpolation: NDArray[np.float64]
    quieter: float = 0.5
    roughness: NDArray[np.float64] | None = None
    shared: NDArray[np.float64] | None = None


def quieter_part(baseline: NDArray, candidate: NDArray, smooth: NDArray[np.bool_]) -> float:
    """The candidate's weight in the mean of two pictures (y, x), each weighted by the other's variance.

    The variances are those of neighbouring pixels inside smooth parts.
    """
    inner = minimum_filter(smooth, 3)
    if inner.sum() < _FEWEST:
        return 0.5
    squares = [high_pass(picture)[inner] ** 2 for picture in (baseline, candidate)]
    own = [float(np.minimum(s, 30 * np.median(s)).mean()) for s in squares]
    return own[0] / sum(own) if sum(own) > 0 else 0.5


def roughness_of(
    baseline: NDArray[np.float64], candidate: NDArray[np.float64], body: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(y, x) from the variances of two pictures (y, x, w), each over its own mean.

    A variance that is estimated together with a mean is smaller where the mean is, and weights from it would bias the
    mean. The parts of the two are such that these biases of their difference cancel.
    """
    first, second = (np.sqrt(variance).sum(axis=-1) ** 2 for variance in (baseline, candidate))
    scales = [max(float(variance[body].mean()), 1e-300) for variance in (first, second)]
    part = np.sqrt(scales[0]) / np.sqrt(scales).sum()
    return np.asarray((1 - part) * first / scales[0] + part * second / scales[1])


def pooled_means(pooling: Pooling, names_of_bands: Sequence[str]) -> tuple[PooledMean, ...]:
    """The whole picture twice, each surface, each band, edges, border and lamp, a grid of blocks, and patterns."""
    strata, bands = pooling.strata, len(names_of_bands)
    ones = np.ones(bands)
    found = [pool_of(pooling, "whole", "whole picture", strata.body, ones, 1)]
    names = strata.surfaces
    found += [pool_of(pooling, "surface", n, mask, ones, len(names)) for n, mask in names.items()]
    found += [
        pool_of(pooling, "band", name, strata.body, row, bands)
        for name, row in zip(names_of_bands, np.eye(bands), strict=True)
    ]
    parts = {"edges": strata.edges, "border": strata.border, "lamp": strata.lamp & strata.used}
    found += [pool_of(pooling, "stratum", n, mask, ones, len(parts)) for n, mask in parts.items()]
    found += [
        pool_of(
            pooling,
            "block",
            f"row {i // BLOCKS + 1}, column {i % BLOCKS + 1}",
            strata.smooth & (strata.block == i),
            ones,
            BLOCKS**2,
        )
        for i in range(BLOCKS**2)
    ]
    return (*(row for row in found if row is not None), *_even(pooling), *_patterns(pooling))


def pool_of(
    pooling: Pooling, kind: str, name: str, mask: NDArray[np.bool_], weights: NDArray[np.float64], count: int
) -> PooledMean | None:
    """The mean of one pool, one of ``count`` of its kind; None where it holds too few pixels or no light."""
    trimmed, noise = pooling.trimmed, pooling.noise
    level = float((trimmed.level[mask] @ weights).sum())
    pixels = int(mask.sum())
    if pixels < _FEWEST or level <= 0:
        return None
    difference = float((trimmed.difference[mask] @ weights).sum())
    each = noise.total[mask] if weights.all() else noise.over(weights)[mask]
    quiet = np.where(trimmed.outlier[mask], np.median(each), each)
    stated = float(quiet.sum())
    scatter = _scatter(pooling, kind, mask, weights, difference / level)
    variance = max(stated, scatter) * noise.clustering
    # light set aside as outliers may belong to the picture: up to each pixel's own radiance it counts as uncertain
    share = float(weights.sum() / weights.size)
    bound = trimmed.level[mask].sum(axis=-1)
    aside = float(np.clip(trimmed.excess[mask], -bound, bound).sum()) * share
    allowed = float(np.mean(pooling.interpolation)) if weights.all() else float(pooling.interpolation @ weights)
    variance += aside**2 + (SYSTEMATIC * level) ** 2 + (allowed * level) ** 2
    if pooling.shared is not None:
        variance += float((pooling.shared[mask] @ weights).sum()) ** 2
    degrees = max(2.0, min(stated**2 / max(float((quiet**2).sum()) / noise.degrees, 1e-300), pixels - 1.0))
    if kind in ("block", "stratum"):
        degrees = min(degrees, _BLOCK_DEGREES)
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


def _even(pooling: Pooling) -> list[PooledMean]:
    """The mean of the relative differences of cells, each weighted by its precision: the sharpest test of a change by
    about the same factor everywhere, as of a paint or of the depth of paths.

    Cells are surfaces, edges and border, in each block of the grid.
    """
    strata, noise, trimmed = pooling.strata, pooling.noise, pooling.trimmed
    part = np.zeros(strata.block.shape, int)
    for number, mask in enumerate((strata.edges, strata.border, *strata.surfaces.values()), start=1):
        part[mask] = number
    body = strata.body
    _, cell, pixels = np.unique((part * BLOCKS**2 + strata.block)[body], return_inverse=True, return_counts=True)
    outlier, each = trimmed.outlier[body], noise.total[body]
    quiet = np.where(outlier, np.median(each), each)
    bound = trimmed.level[body].sum(axis=-1)
    aside = np.clip(trimmed.excess[body], -bound, bound)
    rough = each if pooling.roughness is None else pooling.roughness[body]
    rough = np.where(outlier, np.median(rough), rough)
    own = trimmed.difference[body].sum(axis=-1)
    about = (own - bound * (own.sum() / max(float(bound.sum()), 1e-300))) ** 2
    shared = 0 * own if pooling.shared is None else pooling.shared[body].sum(axis=-1)
    sums = (bound, own, quiet, about, aside, rough, shared)
    told = (pixels >= _FEWEST) & (np.bincount(cell, bound) > 0)
    level, difference, stated, seen, excess, unrest, common = (np.bincount(cell, values)[told] for values in sums)
    if level.size < _FEWEST:
        return []
    more = noise.clustering * (max(1.0, noise.ratio) if np.isfinite(noise.ratio) else 1.0)
    floor = (_CELL_FLOOR * level) ** 2
    variance = np.maximum(more * stated, noise.clustering * seen) + floor
    weight = level**2 / (unrest * variance.sum() / max(float(unrest.sum()), 1e-300) + floor)  # of relative differences
    weight = np.minimum(weight, _HEAVIEST * np.median(weight)) / level
    total = float(weight @ level)
    allowed = float(np.hypot(SYSTEMATIC, np.mean(pooling.interpolation)))
    sigma = np.sqrt(float(weight**2 @ variance) + float(weight @ excess) ** 2 + float(weight @ common) ** 2) / total
    return [
        _row(
            pooling,
            "even",
            "weighted by precision",
            int(pixels[told].sum()),
            difference=float(weight @ difference) / total,
            sigma=float(np.hypot(sigma, allowed)),
            degrees=level.size - 1.0,
            count=1,
        )
    ]


def _scatter(pooling: Pooling, kind: str, mask: NDArray[np.bool_], weights: NDArray[np.float64], mean: float) -> float:
    """Variance of the sum as the pool's own pixels tell.

    Their squares about the mean bound what a single pixel can do: a firefly that is not set aside makes no alarm.
    """
    own = pooling.trimmed.difference @ weights
    about = float(((own - mean * (pooling.trimmed.level @ weights))[mask] ** 2).sum())
    inner = mask & pooling.strata.smooth
    if kind == "stratum" or inner.sum() < _FEWEST:
        return about
    squares = high_pass(own)[inner] ** 2
    # cut where a corner of the pattern touches an edge
    return max(about, float(np.minimum(squares, 30 * np.median(squares)).mean()) * int(mask.sum()))


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
    critical = pooling.false_alarms * SHARES[kind] / count
    statistic = difference / sigma
    threshold = float(t.isf(critical / 2, degrees))
    return PooledMean(
        kind,
        name,
        pixels,
        difference,
        sigma,
        degrees,
        statistic,
        float(2 * t.sf(abs(statistic), degrees)),
        critical,
        (threshold + float(norm.ppf(_POWER))) * sigma,
        unit,
    )


def _patterns(pooling: Pooling) -> list[PooledMean]:
    """How far edges moved along x and y, outwards and clockwise (at half a width from the centre), px, and by how much
    variance they are blurred, px^2.

    Each edge pixel tells with its own sign; the sum over its own root sum of squares is the statistic, which
    needs no variance to be known and which heavy tails make smaller, not larger.
    """
    strata, trimmed = pooling.strata, pooling.trimmed
    level, total = trimmed.level.sum(axis=-1), trimmed.difference.sum(axis=-1)
    # slopes from a mean whose noise does not go with that of the difference, or noise would look like sharper edges
    half = level + total * pooling.quieter
    quiet = median_filter(half, 3, mode="nearest")
    span = maximum_filter(half, 3) - minimum_filter(half, 3)
    sigma = smooth_variance(quiet, pooling.noise.total, pooling.noise.degrees)
    down, right = np.gradient(half)
    curved = -_laplacian(half)
    own = np.pad(np.ones(np.subtract(level.shape, 2), bool), 1)
    places = strata.used & own & (strata.edges | strata.lamp)
    weight = np.where(places, 1 / np.maximum(span**2 + _CLEAR_SIGMAS**2 * sigma, 1e-300), 0.0)
    scale = trimmed.difference.sum() / max(float(trimmed.level.sum()), 1e-300)
    left = total - scale * half
    common = 0 * total if pooling.shared is None else pooling.shared.sum(axis=-1)
    y, x = (axis - (axis.max() / 2) for axis in np.indices(level.shape))
    x, y = 2 * x / level.shape[1], 2 * y / level.shape[1]
    patterns = (
        ("shift x", -right, "px", 0.0),
        ("shift y", -down, "px", 0.0),
        ("magnification", -(right * x + down * y), "px", 0.0),
        ("turn", right * y - down * x, "px", 0.0),
        ("blur", -curved / 2, "px^2", _SHARP),
    )
    found = []
    for name, slope, unit, clear in patterns:
        where = places & (np.abs(slope) > clear * span)
        # what brightens all pixels alike is no pattern, nor is the error of ``scale``, which they share
        w, s, lit = weight[where], slope[where], half[where]
        s = s - lit * (w * s * lit).sum() / max(float((w * lit**2).sum()), 1e-300)
        terms, norms = w * s * left[where], w * s**2
        root = float(np.hypot(np.sqrt((terms**2).sum() * pooling.noise.clustering), (w * s) @ common[where]))
        if where.sum() < 2 * _FEWEST or root == 0 or (terms**2).sum() ** 2 < 10 * (terms**4).sum():
            continue
        size, sigma_of = float(terms.sum() / norms.sum()), root / float(norms.sum())
        found.append(
            _row(
                pooling,
                "pattern",
                name,
                int(where.sum()),
                difference=size,
                sigma=sigma_of,
                degrees=where.sum() - 1.0,
                count=len(patterns),
                unit=unit,
            )
        )
    return found


def _laplacian(picture: NDArray) -> NDArray[np.float64]:
    """(y, x) second derivative along rows and columns together."""
    along = np.pad(picture, 1, mode="edge")
    return along[2:, 1:-1] + along[:-2, 1:-1] + along[1:-1, 2:] + along[1:-1, :-2] - 4 * picture
