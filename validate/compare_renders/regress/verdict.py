"""Did a picture change? Two sides, one verdict at a stated rate of false alarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.stats import t

from .grids import Common, common_wavelengths
from .noise import Noise, noise_of, smooth_variance, variance_of
from .outcome import Outcome
from .outliers import Trimmed, trimmed
from .pooled import Pooling, pooled_means, quieter_part, roughness_of
from .sides import Side, SurfaceMap
from .strata import Strata, strata_of

__all__ = ["FALSE_ALARMS", "Comparison", "compared_sides", "regress_sides"]

#: Of all verdicts on equal pictures, at most this part says "different".
FALSE_ALARMS = 1e-3
#: Of the pixels said to differ by themselves, this part may be wrong.
_FALSE_DISCOVERIES = 0.01
#: Shortest side of a picture, px: edges and noise are found in 3 x 3 pixels.
_SHORTEST_SIDE_PX = 3
#: Scatter of neighbours over what the sides state, from which on it is said.
_TELLING = 1.5


@dataclass(frozen=True, eq=False)
class Comparison:
    """What the verdict and the naming share: both sides on one grid, strata, noise, outliers set aside."""

    common: Common
    strata: Strata
    noise: Noise
    trimmed: Trimmed
    pooling: Pooling


def compared_sides(
    baseline: Side, candidate: Side, surfaces: SurfaceMap | None = None, false_alarms: float = FALSE_ALARMS
) -> Comparison:
    """surfaces : in place of those of the cubes. Raises InputError where the sides cannot be compared."""
    rows, columns = baseline.shape
    if min(rows, columns) < _SHORTEST_SIDE_PX:
        least = f"{_SHORTEST_SIDE_PX} x {_SHORTEST_SIDE_PX} px or more: noise and edges come from neighbouring pixels"
        hint = "cbox compare states the differences without a verdict."
        raise InputError(baseline.source, f"a picture of {columns} x {rows} px", least, hint)
    common = common_wavelengths(candidate, baseline)
    a, b = common.candidate, common.baseline
    own = surfaces or b.surfaces or a.surfaces
    strata = strata_of(b.radiance.sum(axis=-1), own)
    difference = a.radiance - b.radiance
    coarse = [side.rounding for side in (a, b) if side.rounding is not None]
    rounding, shared = sum((part**2 for part in coarse[1:]), coarse[0] ** 2) if coarse else (0.0, None)
    stated = (a.variance, b.variance), (a.degrees, b.degrees), rounding
    cut = trimmed(difference, b.radiance, *variance_of(difference, b.radiance, strata.smooth, *stated), strata.lamp)
    del difference
    noise = noise_of(cut.difference, cut.level, strata.smooth, *stated)
    if cut.outlier.any():
        noise = noise.with_quiet_outliers(cut.level, cut.outlier)
    before = cut.level.sum(axis=-1)
    quieter = quieter_part(before, before + cut.difference.sum(axis=-1), strata.smooth)
    roughness = None if a.variance is None or b.variance is None else roughness_of(b.variance, a.variance, strata.body)
    steps = None if shared is None else np.sqrt(shared)
    pooling = Pooling(cut, noise, strata, false_alarms, common.interpolation, quieter, roughness, steps)
    return Comparison(common, strata, noise, cut, pooling)


def regress_sides(
    baseline: Side, candidate: Side, surfaces: SurfaceMap | None = None, false_alarms: float = FALSE_ALARMS
) -> tuple[Outcome, Comparison]:
    """The verdict, unnamed, and what naming needs. Arguments as ``compared_sides``."""
    found = compared_sides(baseline, candidate, surfaces, false_alarms)
    pools = pooled_means(found.pooling, found.common.baseline.bands)
    if not pools or pools[0].kind != "whole":
        raise InputError(
            baseline.source, "a picture without light, or of a few pixels", "a lit scene, 12 pixels or more"
        )
    body = found.strata.body
    level = float(found.trimmed.level[body].sum())
    notes = [
        *found.common.baseline.notes,
        *found.common.candidate.notes,
        *found.common.notes,
        *_remarks(found),
    ]
    outcome = Outcome(
        baseline=baseline.source,
        candidate=candidate.source,
        pools=pools,
        false_alarms=false_alarms,
        outliers=int((found.trimmed.outlier & body).sum()),
        outlier_share=float(found.trimmed.excess[body].sum()) / level if level else 0.0,
        pixels_differing=_differing(found),
        relative=_relative(found),
        notes=tuple(notes),
    )
    return outcome, found


def _remarks(found: Comparison) -> list[str]:
    notes = []
    if not found.strata.mapped:
        notes.append("no surface map: edges and lamp are told by the picture, and no surface by name")
    if np.array_equal(found.common.candidate.radiance, found.common.baseline.radiance):
        notes.append(
            "both sides have the same numbers to the bit: between independent pictures noise would hide a larger "
            "change than is stated as detectable"
        )
    ratio = found.noise.ratio
    if np.isfinite(ratio) and ratio > _TELLING and not found.noise.estimated:
        notes.append(f"neighbouring pixels scatter {np.sqrt(ratio):.2g} times as much as the standard errors say")
    if found.noise.clustering > 1:
        notes.append(
            f"neighbouring pixels are correlated: variances of means are {found.noise.clustering:.2g} times larger"
        )
    return notes


def _relative(found: Comparison) -> NDArray[np.float64]:
    level = found.common.baseline.radiance.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(level > 0, found.common.candidate.radiance.sum(axis=-1) / level - 1, np.nan)


def _differing(found: Comparison) -> int:
    """Pixels with a false discovery rate of 1 % (Benjamini and Hochberg), as Student's t.

    Degrees of freedom : twice those behind a variance, which neighbours share, but no more than 8, since single
    pixels are not normal.
    """
    body = found.strata.body
    total = found.common.candidate.radiance.sum(axis=-1) - found.common.baseline.radiance.sum(axis=-1)
    sigma = np.sqrt(smooth_variance(found.trimmed.level.sum(axis=-1), found.noise.total, found.noise.degrees))
    sigma = sigma * np.sqrt(max(1.0, found.noise.ratio if np.isfinite(found.noise.ratio) else 1.0))
    size, scatter = np.abs(total[body]), sigma[body]
    # without scatter every difference is one
    sigmas = np.divide(size, scatter, out=np.where(size > 0, np.inf, 0.0), where=scatter > 1e-280)
    probability = np.sort(2 * t.sf(sigmas, min(8.0, 2 * found.noise.degrees)))
    below = np.flatnonzero(
        probability <= _FALSE_DISCOVERIES * np.arange(1, probability.size + 1) / max(probability.size, 1)
    )
    return int(below[-1]) + 1 if below.size else 0
