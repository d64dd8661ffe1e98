"""What a change has to explain: means of cells of the picture in groups of bands, and pixels at edges.

A cell is the part of one surface inside one block of 8 x 8 pixels. Every change of the picture becomes a list of
numbers over their standard deviations, in which a right explanation leaves squares of 1 on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .noise import local_range, smooth_variance
from .verdict import Comparison

__all__ = ["Evidence", "Fit", "build_evidence"]

#: Pixels a side of a cell, groups of bands, fewest pixels of a cell.
_CELL_PX, _GROUPS, _FEWEST = 8, 8, 6
#: Relative standard deviations that no noise explains: of a cell's mean, of an edge pixel; and part of the local range,
#: the second where a side states no errors. Those at edges are then guessed from smooth parts, but with 20 rays in
#: either picture the part of a pixel beyond an edge is known no better.
_CELL_FLOOR, _PIXEL_FLOOR, _RANGE_FLOOR, _RANGE_GUESSED = 5e-4, 1e-3, 0.05, 0.15
#: Residuals beyond so many standard deviations count linearly (Huber 1964); single pixels no more beyond _MOST.
_HUBER, _MOST = 4.0, 20.0


@dataclass(frozen=True, eq=False)
class Fit:
    """amplitudes : of the templates. chi2 : what remains, Huber's."""

    amplitudes: NDArray[np.float64]
    chi2: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """baseline, candidate : (y, x, w), outliers set aside. cell : (y, x) number of the cell, -1 for none.

    whitener : (c, g, g) of each cell's relative changes. level : (c, g) the baseline's sums. group : (w,) of each
    band. pixels : (y, x) at edges, lamp and border. scale : of those, 1 / standard deviation. target : (n,).
    """

    baseline: NDArray[np.float64]
    candidate: NDArray[np.float64]
    cell: NDArray[np.int64]
    whitener: NDArray[np.float64]
    level: NDArray[np.float64]
    group: NDArray[np.int64]
    pixels: NDArray[np.bool_]
    scale: NDArray[np.float64]
    target: NDArray[np.float64]

    @property
    def numbers(self) -> int:
        """How many numbers a change has to explain."""
        return int(self.target.size)

    @property
    def groups(self) -> int:
        """Groups of bands."""
        return int(self.group.max()) + 1

    def grouped(self) -> Evidence:
        """The same with the bands of a group added up, for changes that act on all bands alike."""
        starts = np.searchsorted(self.group, np.arange(self.groups))
        baseline, candidate = (np.add.reduceat(p, starts, axis=-1) for p in (self.baseline, self.candidate))
        return replace(self, baseline=baseline, candidate=candidate, group=np.arange(self.groups))

    def features(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of a change of the picture (y, x, w)."""
        return _features(change, self.cell, self.group, self.level, self.whitener, self.pixels, self.scale)

    def fit(self, templates: Sequence[NDArray[np.float64]], fixed: NDArray[np.float64] | None = None) -> Fit:
        """Amplitudes of templates (y, x, w) beside a ``fixed`` change, by iterated weighted least squares."""
        goal = self.target if fixed is None else self.target - self.features(fixed)
        if not templates:
            return Fit(np.zeros(0), self._left(goal) if np.isfinite(goal).all() else np.inf)
        columns = np.stack([self.features(template) for template in templates], axis=1)
        if not np.isfinite(columns).all():  # a change out of all bounds
            return Fit(np.zeros(columns.shape[1]), np.inf)
        amplitudes: NDArray[np.float64] = np.zeros(columns.shape[1])
        for step in range(8):
            left = np.abs(goal - columns @ amplitudes)
            weight = np.ones(left.size) if step == 0 else np.minimum(1.0, _HUBER / np.maximum(left, 1e-12))
            root = np.sqrt(weight)
            amplitudes = np.asarray(np.linalg.lstsq(columns * root[:, None], goal * root, rcond=1e-9)[0], float)
        return Fit(amplitudes, self._left(goal - columns @ amplitudes))

    def _left(self, residual: NDArray[np.float64]) -> float:
        cells = self.level.size
        return huber(residual[:cells]) + huber(np.clip(residual[cells:], -_MOST, _MOST))


def huber(residual: NDArray[np.float64]) -> float:
    """Sum of squares, beyond _HUBER linear."""
    size = np.abs(residual)
    return float(np.where(size < _HUBER, size**2, 2 * _HUBER * size - _HUBER**2).sum())


def build_evidence(found: Comparison) -> Evidence:
    """From what a verdict is made of."""
    strata, noise, trimmed = found.strata, found.noise, found.trimmed
    level, count = trimmed.level, trimmed.level.shape[-1]
    groups = min(_GROUPS, count)
    group = np.arange(count) * groups // count
    cell = _cells(found)
    cells = int(cell.max()) + 1
    sums = _sums(level, cell, group, cells)
    rows = np.stack([(group == g).astype(float) for g in range(groups)])
    variances = np.stack([noise.over(row) for row in rows], axis=-1)
    inflation = noise.clustering * max(1.0, min(noise.ratio, 9.0) if np.isfinite(noise.ratio) else 1.0)
    inside = cell >= 0
    variance = np.stack([np.bincount(cell[inside], variances[..., g][inside], cells) for g in range(groups)], axis=-1)
    safe = np.maximum(sums, 1e-6 * max(float(sums.max(initial=0.0)), 1e-300))
    shared = found.pooling.shared
    common = 0.0 if shared is None else _sums(shared, cell, group, cells)
    deviation = np.sqrt(variance * inflation + common**2) / safe
    correlation = _grouped(noise.correlation, noise.variance, rows)
    covariance = deviation[:, :, None] * deviation[:, None, :] * correlation
    covariance += np.eye(groups) * _CELL_FLOOR**2
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    pixels = strata.used & ~strata.smooth
    total = level.sum(axis=-1)
    sigma = np.maximum(smooth_variance(total, noise.total, noise.degrees), noise.total) * inflation
    part = _RANGE_GUESSED if noise.estimated else _RANGE_FLOOR
    sigma += (_PIXEL_FLOOR * total) ** 2 + (part * local_range(total)) ** 2
    scale = 1 / np.sqrt(sigma[pixels])
    target = _features(trimmed.difference, cell, group, safe, whitener, pixels, scale)
    return Evidence(level, level + trimmed.difference, cell, whitener, safe, group, pixels, scale, target)


def _cells(found: Comparison) -> NDArray[np.int64]:
    smooth = found.strata.smooth
    rows, columns = (np.arange(size) // _CELL_PX for size in smooth.shape)
    key = (rows[:, None] * (columns.max() + 1) + columns) * (len(found.strata.surfaces) + 1)
    for number, mask in enumerate(found.strata.surfaces.values(), start=1):
        key = key + number * mask
    _, index, counts = np.unique(np.where(smooth, key, -1), return_inverse=True, return_counts=True)
    index = index.reshape(smooth.shape)
    kept = (counts >= _FEWEST)[index] & smooth
    result = np.full(smooth.shape, -1)
    result[kept] = np.unique(index[kept], return_inverse=True)[1]
    return result


def _grouped(correlation: NDArray | None, variance: NDArray, rows: NDArray) -> NDArray[np.float64]:
    """(g, g) correlation between sums over groups of bands, for the picture's mean variances; where it is not known the
    identity times g, which no correlation exceeds in any direction."""
    if correlation is None:
        return len(rows) * np.eye(len(rows))
    sigma = np.sqrt(variance.reshape(-1, variance.shape[-1]).mean(axis=0))
    covariance = rows @ (correlation * np.outer(sigma, sigma)) @ rows.T
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return covariance / np.outer(scale, scale)


def _sums(picture: NDArray, cell: NDArray, group: NDArray, cells: int) -> NDArray[np.float64]:
    inside = cell >= 0
    own = cell[inside]
    starts = np.searchsorted(group, np.arange(group.max() + 1))
    grouped = np.add.reduceat(picture[inside], starts, axis=-1)
    return np.stack([np.bincount(own, column, cells) for column in grouped.T], axis=-1)


def _features(
    change: NDArray,
    cell: NDArray,
    group: NDArray,
    level: NDArray,
    whitener: NDArray,
    pixels: NDArray,
    scale: NDArray,
) -> NDArray[np.float64]:
    relative = _sums(change, cell, group, len(level)) / level
    cells = np.einsum("cij,cj->ci", whitener, relative).ravel()
    return np.concatenate([cells, change.sum(axis=-1)[pixels] * scale])
