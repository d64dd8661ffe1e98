"""Static nonlinearity: monotone curve from counts to linear light.

A camera that maps its linear values to fewer bits has counts r = F(a_k x + n) (Vora et al. 2001, Appendix C and D).
F is the same for all series k of exposures or irradiances, and each series has a scale a_k. The curve g = F^-1 is
monotone and piecewise linear between knots. It is 0 at the dark level and 1 at the largest observed count. Curve and
scales are fitted together,

    g(r_kj) = a_k x_kj    for all points j of all series k.

The paper instead fits the curve to one series and each other scale to one point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

__all__ = ["CalibrationCurve", "LightSeries", "fit_curve"]

#: Iterations of the fit, each with the slopes of the last one.
_ITERATIONS = 6
#: Weight of the curve's changes of slope relative to the points.
_SMOOTHNESS = 0.02


@dataclass(frozen=True, eq=False)
class LightSeries:
    """Exposures of one light of unknown scale."""

    #: Name of the series.
    name: str
    #: (n,) exposure times irradiance, any unit.
    light: NDArray[np.float64]
    #: (n,) mean counts, dark included, DN.
    count: NDArray[np.float64]
    #: (n,) standard deviations of the counts, DN.
    sigma: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibrationCurve(FrozenMappings):
    """Monotone curve from counts to linear light and how well it fits."""

    #: (m,) counts at the knots, from the dark level to the largest count, DN.
    knot_count: NDArray[np.float64]
    #: (m,) linear light at the knots, from 0 to 1.
    knot_value: NDArray[np.float64]
    #: By name of the series, its scale a_k.
    scales: Mapping[str, float]
    #: (n,) g(r) - a x of all points in the order given, fractions of full scale.
    residual: NDArray[np.float64]
    #: (n,) the same in counts: divided by the local slope of the curve, DN.
    residual_dn: NDArray[np.float64]
    #: Root mean square residual of a straight line, for comparison.
    line_rms: float

    def linear(self, count: ArrayLike) -> NDArray[np.float64]:
        """Linear light of counts.

        Parameters
        ----------
        count
            (...) counts, DN.

        Returns
        -------
        NDArray
            (...) linear light, 0 to 1 between the ends of the curve and extrapolated linearly beyond them.
        """
        r = np.asarray(count, float)
        inside = np.interp(r, self.knot_count, self.knot_value)
        slopes = np.diff(self.knot_value) / np.diff(self.knot_count)
        below, above = np.minimum(r - self.knot_count[0], 0), np.maximum(r - self.knot_count[-1], 0)
        return np.asarray(inside + below * slopes[0] + above * slopes[-1], np.float64)

    def count(self, linear: ArrayLike) -> NDArray[np.float64]:
        """Counts of linear light.

        Parameters
        ----------
        linear
            (...) linear light; values outside 0 to 1 are taken as 0 or 1.

        Returns
        -------
        NDArray
            (...) counts, DN.
        """
        return np.interp(np.asarray(linear, float), self.knot_value, self.knot_count)

    @property
    def statistics(self) -> dict[str, float]:
        """Mean absolute, root mean square and largest residual.

        Keys ending in ``_dn`` are in counts, the others in fractions of full scale.
        """
        statistics: dict[str, float] = {}
        for name, values in (("", self.residual), ("_dn", self.residual_dn)):
            statistics |= {
                f"mean_absolute{name}": float(np.abs(values).mean()),
                f"rms{name}": float(np.sqrt(np.mean(values**2))),
                f"largest{name}": float(np.abs(values).max()),
            }
        return statistics


def _increment_basis(count: NDArray[np.float64], knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, m - 1) basis with g = basis @ increments, piecewise linear and 0 at the first knot."""
    share = (count[:, None] - knots[None, :-1]) / np.diff(knots)
    share[:, 1:-1] = np.clip(share[:, 1:-1], 0, 1)
    share[:, 0] = np.minimum(share[:, 0], 1)
    share[:, -1] = np.maximum(share[:, -1], 0)
    return share


def fit_curve(series: Sequence[LightSeries], dark_count: float, knots: int = 24) -> CalibrationCurve:
    """Fit the curve and the scale of every series by least squares with non-negative increments.

    The sigma of a residual is that of the count times the slope of the curve. The slope is that of the previous
    iteration; otherwise a steep curve would reduce its weighted residuals.

    Parameters
    ----------
    series
        The series of light; at least 6 points in all.
    dark_count
        Dark level, at which the curve is 0, DN.
    knots
        Largest number of knots; at most half the number of points is used.

    Returns
    -------
    CalibrationCurve
        Knots closer to each other than the noise of the counts are left out.

    Raises
    ------
    ValueError
        For fewer than 6 points, or if no count is above the dark level.
    """
    light, count, sigma = (
        np.concatenate([getattr(s, name) for s in series]).astype(float) for name in ("light", "count", "sigma")
    )
    which = np.concatenate([np.full(len(s.light), k) for k, s in enumerate(series)])
    if count.size < 6 or count.max() <= dark_count:
        raise ValueError("a calibration curve needs at least 6 points with counts above the dark level")
    size = int(np.clip(min(knots, count.size // 2), 3, None))
    knot_counts = np.quantile(count, np.linspace(0, 1, size))[:-1]
    knot_counts = np.unique(np.concatenate([[dark_count], knot_counts[knot_counts > dark_count], [count.max()]]))
    # Knots closer to each other than the noise of the counts would fit noise.
    apart = max(float(np.median(sigma)), 1e-3 * float(count.max() - dark_count))
    spaced_knots = [knot_counts[0]]
    spaced_knots += [p for p in knot_counts[1:-1] if p - spaced_knots[-1] > apart and knot_counts[-1] - p > apart]
    knot_counts = np.array([*spaced_knots, knot_counts[-1]])
    curve, scales = _fit(light, count, sigma, which, knot_counts, len(series))
    straight, _ = _fit(light, count, sigma, which, knot_counts[[0, -1]], len(series))
    slope = np.gradient(curve, knot_counts)
    residual = _increment_basis(count, knot_counts) @ np.diff(curve) - scales[which] * light
    line = _increment_basis(count, knot_counts[[0, -1]]) @ np.diff(straight)
    line_scales = np.array([_scale(light[which == k], line[which == k]) for k in range(len(series))])
    return CalibrationCurve(
        knot_counts,
        curve,
        {s.name: float(a) for s, a in zip(series, scales, strict=True)},
        residual,
        residual / np.maximum(np.interp(count, knot_counts, slope), 1e-12),
        float(np.sqrt(np.mean((line - line_scales[which] * light) ** 2))),
    )


def _scale(light: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    """Least-squares scale a of value = a light."""
    return float(np.sum(light * value) / np.sum(light**2))


def _fit(
    light: NDArray[np.float64],
    count: NDArray[np.float64],
    sigma: NDArray[np.float64],
    which: NDArray[np.int64],
    knot_counts: NDArray[np.float64],
    series: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(m,) values at the knots, 1 at the last, and (series,) scales in units of 1 / light."""
    widths = np.diff(knot_counts)
    basis = _increment_basis(count, knot_counts)
    unit = np.array([light[which == k].max() for k in range(series)])
    members = np.zeros((count.size, series))
    members[np.arange(count.size), which] = -light / unit[which]
    rows = np.hstack([basis, members])
    bends = np.diff(np.diag(1 / widths), axis=0) * (widths[:-1] + widths[1:])[:, None] / 2
    values = (knot_counts - knot_counts[0]) / (knot_counts[-1] - knot_counts[0])
    solution = np.zeros(rows.shape[1])
    for _ in range(_ITERATIONS):
        slope = np.maximum(np.interp(count, knot_counts, np.gradient(values, knot_counts)), 1e-3 / np.ptp(knot_counts))
        noise = slope * sigma
        smooth = np.hstack([bends * _SMOOTHNESS / np.median(noise), np.zeros((len(bends), series))])
        # The equations are homogeneous: a row of large weight sets the last value to 1.
        top = np.concatenate([np.ones(widths.size), np.zeros(series)]) * 1e4 / np.median(noise)
        system = np.vstack([rows / noise[:, None], smooth, top])
        right = np.concatenate([np.zeros(len(rows) + len(bends)), [1e4 / np.median(noise)]])
        solution = lsq_linear(system, right, bounds=(0, np.inf), method="bvls").x
        values = np.concatenate([[0.0], np.cumsum(solution[: widths.size])])
        values = values / values[-1]
    return values, solution[widths.size :] / unit
