"""Evidence for the naming of a change: means of cells in groups of bands, edge pixels.

A cell is the part of one surface inside one block of 8 x 8 pixels. Every change of the picture becomes a list of
numbers over their standard deviations, in which a right explanation leaves squares of 1 on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .noise import local_range, smooth_variance
from .verdict import RegressionData

__all__ = ["Evidence", "Fit", "build_evidence"]

#: Pixels a side of a cell: small enough to show a shadow, large enough for a mean with little noise.
_CELL_PX = 8
#: Most groups of bands: enough for the shape of a paint's spectrum.
_MAX_GROUPS = 8
#: Fewest pixels of a cell.
_MIN_CELL_PX = 6
#: Relative standard deviation that is added to a cell's mean: the accuracy of computed changes.
_CELL_FLOOR = 5e-4
#: Relative standard deviation that is added to an edge pixel.
_PIXEL_FLOOR = 1e-3
#: Standard deviation that is added to an edge pixel, over the local range of the radiance.
_RANGE_FLOOR = 0.05
#: The same where a side states no errors. Those at edges are then estimated from smooth parts. With 20 rays a pixel
#: the part of a pixel beyond an edge is known to 0.15 at best.
_RANGE_FLOOR_UNSTATED = 0.15
#: Residual, in standard deviations, beyond which it counts linearly (Huber 1964).
_HUBER_SIGMAS = 4.0
#: Residual of a single pixel, in standard deviations, beyond which it counts no more.
_MAX_PIXEL_SIGMAS = 20.0
#: Largest ratio of the scatter of neighbours to the stated variance that inflates variances.
_MAX_INFLATION = 9.0
#: Steps of iterated weighted least squares; Huber's weights settle in five.
_STEPS = 8


@dataclass(frozen=True, eq=False)
class Fit:
    """Fit of templates."""

    #: Amplitude of each template.
    amplitudes: NDArray[np.float64]
    #: Huber's sum of squares of the residuals of cells; infinite for a change that is not finite.
    cells_chi2: float
    #: The same of single pixels.
    pixels_chi2: float = 0.0
    #: (c,) residuals of cells in standard deviations, in single precision; None for a change that is not finite.
    residual: NDArray[np.float32] | None = None
    #: (c, k) numbers of the templates in cells; None with ``residual``.
    columns: NDArray[np.float32] | None = None
    #: Count of the numbers that the change acts on.
    touched: int = 0
    #: Huber's sum of their squares without the change.
    touched_chi2: float = 0.0

    @property
    def chi2(self) -> float:
        """Huber's sum of squares of all residuals."""
        return self.cells_chi2 + self.pixels_chi2


@dataclass(frozen=True, eq=False)
class Evidence:
    """Numbers that a change has to explain."""

    #: (y, x, w) radiance of the baseline without outliers.
    baseline: NDArray[np.float64]
    #: (y, x, w) radiance of the candidate without outliers.
    candidate: NDArray[np.float64]
    #: (y, x) number of the cell; -1 outside of all.
    cell: NDArray[np.int64]
    #: (c, g, g) matrices that give each cell's relative changes unit covariance.
    whitener: NDArray[np.float64]
    #: (c, g) the baseline's sums over cells and groups.
    level: NDArray[np.float64]
    #: (w,) group of each band.
    group: NDArray[np.int64]
    #: (y, x) single pixels: at edges, lamp and border.
    pixels: NDArray[np.bool_]
    #: (p,) 1 / standard deviation of the single pixels.
    scale: NDArray[np.float64]
    #: (n,) numbers of the change from baseline to candidate, over their standard deviations.
    target: NDArray[np.float64]

    @property
    def numbers(self) -> int:
        """Count of the numbers."""
        return int(self.target.size)

    @property
    def groups(self) -> int:
        """Count of groups of bands."""
        return int(self.group.max()) + 1

    def grouped(self) -> Evidence:
        """Evidence with the bands of each group summed, for changes that act on all bands alike.

        Returns
        -------
        Evidence
            The same numbers, with pictures of one plane a group.
        """
        starts = np.searchsorted(self.group, np.arange(self.groups))
        baseline, candidate = (np.add.reduceat(p, starts, axis=-1) for p in (self.baseline, self.candidate))
        return replace(self, baseline=baseline, candidate=candidate, group=np.arange(self.groups))

    def features(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers of a change of the picture.

        Parameters
        ----------
        change
            (y, x, w) change of the radiance.

        Returns
        -------
        NDArray
            (n,) relative means of cells, whitened, and sums of single pixels over their standard deviations.
        """
        return _features(change, self.cell, self.group, self.level, self.whitener, self.pixels, self.scale)

    def fit(self, templates: Sequence[NDArray[np.float64]], fixed: NDArray[np.float64] | None = None) -> Fit:
        """Amplitudes of templates by iterated weighted least squares (Huber 1964).

        Parameters
        ----------
        templates
            Changes (y, x, w) of amplitude 1; none leaves the change as it is.
        fixed
            (y, x, w) change that is subtracted first, without a free number.

        Returns
        -------
        Fit
            Amplitudes and chi-square.
        """
        goal = self.target if fixed is None else self.target - self.features(fixed)
        columns = np.zeros((goal.size, len(templates)))
        for number, template in enumerate(templates):
            columns[:, number] = self.features(template)
        if not (np.isfinite(goal).all() and np.isfinite(columns).all()):  # a change that overflows
            return Fit(np.zeros(len(templates)), np.inf)
        fit, residual = self._fitted(columns, goal)
        touched = np.abs(self.target - residual) > 0
        return replace(fit, touched=int(touched.sum()), touched_chi2=huber(self.target[touched]))

    def explained_by(self, further: NDArray[np.float64], fit: Fit) -> float:
        """Chi-square of a fit's cells that further changes explain.

        The fit's own templates are fitted again on both sides of the comparison.

        Parameters
        ----------
        further
            (n, k) numbers of the further changes, of free amplitudes.
        fit
            The fit.

        Returns
        -------
        float
            The chi-square; 0 for a fit that is not finite.
        """
        if fit.residual is None or fit.columns is None:
            return 0.0
        cells = fit.residual.size
        narrow, residual = fit.columns.astype(float), fit.residual.astype(float)
        wide = np.concatenate([narrow, further[:cells]], axis=1)
        return self._fitted(narrow, residual)[0].cells_chi2 - self._fitted(wide, residual)[0].cells_chi2

    def _fitted(self, columns: NDArray[np.float64], goal: NDArray[np.float64]) -> tuple[Fit, NDArray[np.float64]]:
        """Amplitudes of columns (n, k) by iterated weighted least squares, and the residual (n,)."""
        amplitudes: NDArray[np.float64] = np.zeros(columns.shape[1])
        for step in range(_STEPS if columns.shape[1] else 0):
            size = np.abs(goal - columns @ amplitudes)
            weight = np.ones(size.size) if step == 0 else np.minimum(1.0, _HUBER_SIGMAS / np.maximum(size, 1e-12))
            root = np.sqrt(weight)
            amplitudes = np.asarray(np.linalg.lstsq(columns * root[:, None], goal * root, rcond=1e-9)[0], float)
        residual, cells = goal - columns @ amplitudes, self.level.size
        pixels = np.clip(residual[cells:], -_MAX_PIXEL_SIGMAS, _MAX_PIXEL_SIGMAS)
        residual_in_cells, columns_in_cells = residual[:cells].astype(np.float32), columns[:cells].astype(np.float32)
        return Fit(amplitudes, huber(residual[:cells]), huber(pixels), residual_in_cells, columns_in_cells), residual


def huber(residual: NDArray[np.float64]) -> float:
    """Sum of Huber's loss: squares up to four standard deviations, linear beyond.

    Parameters
    ----------
    residual
        (n,) residuals in standard deviations.

    Returns
    -------
    float
        The sum.
    """
    size, limit = np.abs(residual), _HUBER_SIGMAS
    return float(np.where(size < limit, size**2, 2 * limit * size - limit**2).sum())


def build_evidence(comparison: RegressionData) -> Evidence:
    """Evidence from a comparison.

    Parameters
    ----------
    comparison
        Sides, parts, noise and outliers of a verdict.

    Returns
    -------
    Evidence
        The numbers that a change has to explain.
    """
    strata, noise, trimmed = comparison.strata, comparison.noise, comparison.trimmed
    level, count = trimmed.level, trimmed.level.shape[-1]
    groups = min(_MAX_GROUPS, count)
    group = np.arange(count) * groups // count
    cell = _cells(comparison)
    cells = int(cell.max()) + 1
    sums = _sums(level, cell, group, cells)
    rows = np.stack([(group == g).astype(float) for g in range(groups)])
    variances = np.stack([noise.over(row) for row in rows], axis=-1)
    inflation = noise.clustering * max(1.0, min(noise.ratio, _MAX_INFLATION) if np.isfinite(noise.ratio) else 1.0)
    inside = cell >= 0
    variance = np.stack([np.bincount(cell[inside], variances[..., g][inside], cells) for g in range(groups)], axis=-1)
    safe = np.maximum(sums, 1e-6 * max(float(sums.max(initial=0.0)), 1e-300))
    shared = comparison.pooling.shared
    common = 0.0 if shared is None else _sums(shared, cell, group, cells)
    deviation = np.sqrt(variance * inflation + common**2) / safe
    correlation = _grouped(noise.correlation, noise.variance, rows)
    covariance = deviation[:, :, None] * deviation[:, None, :] * correlation
    covariance += np.eye(groups) * _CELL_FLOOR**2
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    pixels = strata.used & ~strata.smooth
    total = level.sum(axis=-1)
    sigma = np.maximum(smooth_variance(total, noise.total, noise.degrees), noise.total) * inflation
    part = _RANGE_FLOOR_UNSTATED if noise.estimated else _RANGE_FLOOR
    sigma += (_PIXEL_FLOOR * total) ** 2 + (part * local_range(total)) ** 2
    # pixels that are lit in the candidate alone
    sigma = np.where(sigma > 0, sigma, (_PIXEL_FLOOR * max(float(total.mean()), 1e-150)) ** 2)
    scale = 1 / np.sqrt(sigma[pixels])
    target = _features(trimmed.difference, cell, group, safe, whitener, pixels, scale)
    return Evidence(level, level + trimmed.difference, cell, whitener, safe, group, pixels, scale, target)


def _cells(comparison: RegressionData) -> NDArray[np.int64]:
    """(y, x) number of each smooth pixel's cell; -1 for others and for cells of few pixels."""
    smooth = comparison.strata.smooth
    rows, columns = (np.arange(size) // _CELL_PX for size in smooth.shape)
    key = (rows[:, None] * (columns.max() + 1) + columns) * (len(comparison.strata.surfaces) + 1)
    for number, mask in enumerate(comparison.strata.surfaces.values(), start=1):
        key = key + number * mask
    _, index, counts = np.unique(np.where(smooth, key, -1), return_inverse=True, return_counts=True)
    index = index.reshape(smooth.shape)
    used = (counts >= _MIN_CELL_PX)[index] & smooth
    result = np.full(smooth.shape, -1)
    result[used] = np.unique(index[used], return_inverse=True)[1]
    return result


def _grouped(correlation: NDArray | None, variance: NDArray, rows: NDArray) -> NDArray[np.float64]:
    """(g, g) correlation between sums over groups of bands, for the picture's mean variances.

    Where it is unknown it is the identity times g, which no correlation exceeds in any direction.
    """
    if correlation is None:
        return len(rows) * np.eye(len(rows))
    sigma = np.sqrt(variance.reshape(-1, variance.shape[-1]).mean(axis=0))
    covariance = rows @ (correlation * np.outer(sigma, sigma)) @ rows.T
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return covariance / np.outer(scale, scale)


def _sums(picture: NDArray, cell: NDArray, group: NDArray, cells: int) -> NDArray[np.float64]:
    """(c, g) sums of a picture (y, x, w) over cells and groups of bands."""
    inside = cell >= 0
    number = cell[inside]
    starts = np.searchsorted(group, np.arange(group.max() + 1))
    grouped = np.add.reduceat(picture[inside], starts, axis=-1)
    return np.stack([np.bincount(number, column, cells) for column in grouped.T], axis=-1)


def _features(
    change: NDArray,
    cell: NDArray,
    group: NDArray,
    level: NDArray,
    whitener: NDArray,
    pixels: NDArray,
    scale: NDArray,
) -> NDArray[np.float64]:
    """(n,) numbers of a change; see ``Evidence.features``."""
    relative = _sums(change, cell, group, len(level)) / level
    cells = np.einsum("cij,cj->ci", whitener, relative).ravel()
    return np.concatenate([cells, change.sum(axis=-1)[pixels] * scale])
