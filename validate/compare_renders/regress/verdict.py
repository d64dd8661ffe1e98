"""Verdict on two sides, same or different, at a stated rate of false alarms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from ..scene_pictures import NumberSteps, changed_layers, steps_of
from .grids import Common, common_pictures
from .noise import (
    Noise,
    batch_clustering,
    noise_of,
    paired_variance,
    pixels_that_differ,
    quieter_part,
    roughness_of,
    smooth_variance,
    variance_of,
)
from .outcome import Outcome
from .outliers import Trimmed, trimmed
from .patterns import (
    MEANS,
    Difference,
    all_patterns,
    block_changes,
    certain_layers,
    certain_numbers,
    periodic,
    pool_of_finding,
    ranked_squares,
    slow_change,
    tile_steps,
    unknown_mean,
    without_period,
    without_slow,
)
from .pooled import (
    SHARES,
    PooledMean,
    Pooling,
    area_means,
    difference_of,
    pooled_means,
)
from .sides import Side, SurfaceIndices, sound_side
from .strata import Strata, strata_of
from .where import Spot, spot_of

__all__ = ["FALSE_ALARMS", "RegressionData", "compared_areas", "compared_sides", "regress_sides"]

#: Largest part of the verdicts on equal pictures that say "different": one in a thousand runs.
FALSE_ALARMS = 1e-3
#: Shortest side of a picture, px: edges and noise come from 3 x 3 pixels.
_SHORTEST_SIDE_PX = 3
#: Scatter of neighbours over the stated variance, from which a note says so.
_NOTED_RATIO = 1.5
#: Part of the body below which few pixels are smooth: edges are then looked for in the other picture, too.
_MIN_SMOOTH_PART = 0.4
#: Part of the picture that lies inside smooth parts, from which single pictures' noise is estimated there.
_MIN_QUIET_PART = 0.05
#: Pixels of a picture too small for an estimate among edges.
_SMALL_PICTURE_PX = 1500
#: Factor on the correlation of pixels in batches, above which that of the difference is a change of the picture.
_BATCH_MARGIN = 1.5
#: Factor by which the other picture has to have more smooth pixels.
_SMOOTHER = 1.5
#: Probability of steps between tiles below which they are no correlated noise.
_STEPPED = 1e-3
#: Kinds of pools that find a pattern all over the picture.
_EVERYWHERE = ("grid", "wave", "steps", "reused", "shared")
#: Part of the false alarms of tests between cubes that ranks have. Denoisers give them longer tails: the clearest of
#: 1,800 equal pairs of three or four cubes has a probability of 1e-5.
_RANKED = 0.1


@dataclass(frozen=True, eq=False)
class RegressionData:
    """Data that verdict and naming share."""

    #: Both sides on one grid of wavelengths.
    common: Common
    #: Parts of the picture.
    strata: Strata
    #: Noise of the difference.
    noise: Noise
    #: Difference and baseline without outliers.
    trimmed: Trimmed
    #: Input of the pooled tests.
    pooling: Pooling
    #: Pattern in words that was removed before the tests of means; empty without one.
    removed: str = ""


def compared_sides(
    baseline: Side,
    candidate: Side,
    surfaces: SurfaceIndices | None = None,
    false_alarms: float = FALSE_ALARMS,
    allowed: float = 0.0,
) -> RegressionData:
    """Comparison of two sides, before any test.

    Parameters
    ----------
    baseline, candidate
        The sides.
    surfaces
        Map of surfaces in place of those of the cubes.
    false_alarms
        Rate of false alarms of the verdict.
    allowed
        Relative standard deviation of all means besides noise, such as that of a fitted factor.

    Returns
    -------
    RegressionData
        Sides, parts, noise, outliers.

    Raises
    ------
    InputError
        If a side is not sound, if the pictures differ in size, or if their wavelengths do not overlap.
    """
    baseline, candidate = sound_side(baseline), sound_side(candidate)
    rows, columns = baseline.shape
    if min(rows, columns) < _SHORTEST_SIDE_PX:
        least = f"{_SHORTEST_SIDE_PX} x {_SHORTEST_SIDE_PX} px or more: noise and edges come from neighbouring pixels"
        hint = "cbox compare states the differences without a verdict."
        raise InputError(baseline.source, f"a picture of {columns} x {rows} px", least, hint)
    common = common_pictures(candidate, baseline)
    common = replace(common, interpolation=np.hypot(common.interpolation, allowed))
    return _compared(common, _strata(common, surfaces), false_alarms)


def _compared(common: Common, strata: Strata, false_alarms: float) -> RegressionData:
    """Comparison of two sides on one grid of wavelengths."""
    a, b = common.candidate, common.baseline
    difference = a.radiance - b.radiance
    coarse = [side.rounding for side in (a, b) if side.rounding is not None]
    rounding: NDArray[np.float64] | float = 0.0
    shared: NDArray[np.float64] | None = None
    if coarse:
        rounding, shared = np.sum([part**2 for part in coarse], axis=0)
    together = paired_variance(b.batches, a.batches, same_seeds=a.same_seeds and b.same_seeds)
    errors = (a.variance, b.variance), (a.degrees, b.degrees), rounding
    if together is not None and b.batches is not None:
        errors = (together, np.zeros_like(together)), (len(b.batches) - 1.0, 0.0), rounding
    quiet = _quiet(strata, estimated=a.variance is None or b.variance is None)
    variance = variance_of(difference, b.radiance, quiet, *errors)
    cut = trimmed(difference, b.radiance, *variance, strata.lamp)
    del difference
    computed = None if cut.outlier.any() else variance
    del variance
    sums = cut.level.sum(axis=-1), cut.difference.sum(axis=-1)
    steps = tile_steps(Difference(*sums, None, strata.smooth, {}))
    stepped = steps is not None and steps.probability < _STEPPED
    paired = together is not None
    noise = noise_of(cut.difference, cut.level, quiet, *errors, stepped=stepped, paired=paired, variance=computed)
    if a.batches is not None and b.batches is not None and not paired:
        alike = max(batch_clustering(side.batches, sums[0], quiet) for side in (a, b) if side.batches is not None)
        noise = replace(noise, clustering=min(noise.clustering, _BATCH_MARGIN * alike))
    if cut.outlier.any():
        noise = noise.with_quiet_outliers(cut.level, cut.outlier)
    before = cut.level.sum(axis=-1)
    quieter = quieter_part(before, before + cut.difference.sum(axis=-1), strata.smooth)
    # with the same random numbers few pixels differ, and weights by their variances would bias the mean
    roughness = None if together is None else np.maximum(sums[0], 1e-3 * max(float(sums[0].mean()), 1e-300)) ** 2
    if a.variance is not None and b.variance is not None and together is None:
        roughness = roughness_of(b.variance, a.variance, strata.body)
    common_part = None if shared is None else np.sqrt(shared)
    pooling = Pooling(
        cut,
        noise,
        strata,
        false_alarms,
        common.interpolation,
        quieter,
        roughness,
        common_part,
        rounding=_relative_steps(rounding, sums[0]),
        paired=paired,
    )
    return RegressionData(common, strata, noise, cut, pooling)


def _relative_steps(rounding: NDArray[np.float64] | float, level: NDArray[np.float64]) -> float:
    """Median relative standard deviation of bright pixels (y, x) from the steps of files."""
    bright = level > 0
    if not isinstance(rounding, np.ndarray) or not bright.any():
        return 0.0
    return float(np.median(np.sqrt(rounding.sum(axis=-1)[bright]) / level[bright]))


def _quiet(strata: Strata, *, estimated: bool) -> NDArray[np.bool_]:
    """(y, x) pixels from whose neighbours noise is estimated.

    They are the smooth ones, or all but the lamp where few are smooth, as among leaves or hair: most of the structure
    cancels in a difference.
    """
    enough = minimum_filter(strata.smooth, 3).mean() >= _MIN_QUIET_PART or strata.smooth.size < _SMALL_PICTURE_PX
    return strata.smooth if enough or not estimated else strata.body


def _strata(common: Common, surfaces: SurfaceIndices | None) -> Strata:
    """Parts of the baseline, or of the candidate if that has far more smooth pixels."""
    baseline, candidate, missing = common.baseline, common.candidate, common.excluded if common.comparable else None
    surface_map = surfaces or baseline.surfaces or candidate.surfaces
    levels = _total(baseline), _total(candidate)
    strata = strata_of(levels[0], surface_map, levels[1], missing)
    if strata.smooth.sum() > _MIN_SMOOTH_PART * strata.body.sum():
        return strata
    others = strata_of(levels[1], surface_map, levels[0], missing)
    return others if _SMOOTHER * strata.smooth.sum() < others.smooth.sum() else strata


def _without_pattern(comparison: RegressionData, false_alarms: float) -> RegressionData:
    """Comparison without a periodic pattern that decides; itself without one."""
    difference = difference_of(comparison.pooling)
    critical = false_alarms * SHARES["grid"]
    pattern = periodic(difference)
    if pattern is None or pattern.probability >= critical:
        return comparison
    common = comparison.common
    factor = 1 + without_period(difference, pattern)
    side = common.candidate
    steady = replace(
        side,
        radiance=side.radiance / factor[..., None],
        variance=None if side.variance is None else side.variance / factor[..., None] ** 2,
    )
    again = _compared(replace(common, candidate=steady), comparison.strata, false_alarms)
    return replace(again, removed=pattern.name)


def _without_slow(comparison: RegressionData, false_alarms: float) -> RegressionData:
    """Comparison with the noise that a deciding slow change leaves; itself without one.

    A slow change would count as noise that reaches over the picture, and hide its own name.
    """
    slow = slow_change(difference_of(comparison.pooling)) if comparison.noise.estimated else None
    if slow is None or slow.probability >= false_alarms * SHARES["slow"]:
        return comparison
    cut, strata, common = comparison.trimmed, comparison.strata, comparison.common
    variances = common.candidate.variance, common.baseline.variance
    difference = without_slow(cut.difference, cut.level, slow)
    computed = comparison.noise.variance, comparison.noise.degrees
    noise = noise_of(difference, cut.level, _quiet(strata, estimated=True), variances, (0.0, 0.0), variance=computed)
    return replace(comparison, noise=noise, pooling=replace(comparison.pooling, noise=noise))


def compared_areas(baseline: Side, candidate: Side) -> tuple[tuple[PooledMean, ...], RegressionData]:
    """Means of two sides in each area of the picture, without a verdict.

    Parameters
    ----------
    baseline, candidate
        The sides.

    Returns
    -------
    means
        Those of ``area_means``, the entire picture first.
    comparison
        Sides, parts, noise, outliers.

    Raises
    ------
    InputError
        If the sides cannot be compared, or if the baseline has no light.
    """
    _, comparison = _with_and_without_pattern(baseline, candidate, None, FALSE_ALARMS)
    means = area_means(comparison.pooling)
    _require_light(means, baseline)
    return means, comparison


def _with_and_without_pattern(
    baseline: Side, candidate: Side, surfaces: SurfaceIndices | None, false_alarms: float, allowed: float = 0.0
) -> tuple[RegressionData, RegressionData]:
    """Comparison of two sides as it is, and without a periodic pattern that decides."""
    as_found = _without_slow(compared_sides(baseline, candidate, surfaces, false_alarms, allowed), false_alarms)
    return as_found, _without_pattern(as_found, false_alarms)


def _require_light(pools: tuple[PooledMean, ...], baseline: Side) -> None:
    """Raise InputError without a mean of the entire picture."""
    if not pools or pools[0].kind != "whole":
        raise InputError(
            baseline.source, "a picture without light, or of a few pixels", "a lit scene, 12 pixels or more"
        )


def regress_sides(
    baseline: Side,
    candidate: Side,
    surfaces: SurfaceIndices | None = None,
    false_alarms: float = FALSE_ALARMS,
    allowed: float = 0.0,
) -> tuple[Outcome, RegressionData]:
    """Verdict on two sides, without a name of the change.

    Parameters
    ----------
    baseline, candidate, surfaces, false_alarms, allowed
        As in ``compared_sides``.

    Returns
    -------
    outcome
        The verdict with all tests.
    comparison
        Input of the naming.

    Raises
    ------
    InputError
        If the sides cannot be compared, or if the baseline has no light.
    """
    as_found, comparison = _with_and_without_pattern(baseline, candidate, surfaces, false_alarms, allowed)
    absent = as_found.common.not_numbers
    if not as_found.common.comparable:
        _require_light(pools := (unknown_mean(), *certain_numbers(absent, false_alarms)) if absent else (), baseline)
        sides, nowhere = (baseline.source, candidate.source), np.full(baseline.shape, np.nan)
        note = ("too few pixels are numbers on both sides: nothing else is compared",)
        return Outcome(*sides, pools, false_alarms, 0, 0.0, 0, nowhere, (), note, not_numbers=absent), comparison
    pools = pooled_means(comparison.pooling, comparison.common.baseline.bands)
    totals = _total(_sides(as_found)[0]), _total(_sides(as_found)[1])
    cancelling = _cancelling(as_found.pooling, totals, as_found.common)
    _require_light(pools, baseline)
    body = comparison.strata.body
    level = float(comparison.trimmed.level.sum(axis=-1)[body].sum())
    common = comparison.common
    notes = [*common.baseline.notes, *common.candidate.notes, *common.notes, *_remarks(as_found)]
    between = _between_cubes(comparison, false_alarms)
    layers = _layers(*_sides(as_found), false_alarms)
    numbers = _numbers(sound_side(baseline)), _numbers(sound_side(candidate))
    relative = _relative(as_found)
    if common.missing is not None:
        relative[common.missing] = np.nan
    notes += [
        f"the {row.name} layer differs in {row.difference:.1%} of the pixels away from edges"
        for row in layers
        if row.different
    ]
    if comparison.removed:
        notes.append(f"means are tested without the {comparison.removed}")
    outcome = Outcome(
        baseline=baseline.source,
        candidate=candidate.source,
        pools=(*pools, *between, *cancelling, *layers, *certain_numbers(absent, false_alarms)),
        false_alarms=false_alarms,
        outliers=int((comparison.trimmed.outlier & body).sum()),
        outlier_share=float(comparison.trimmed.excess[body].sum()) / level if level else 0.0,
        pixels_differing=pixels_that_differ(
            totals[1] - totals[0], as_found.trimmed.level, as_found.noise, as_found.strata.body
        ),
        relative=relative,
        notes=tuple(notes),
        single_pictures=comparison.noise.estimated,
        looks_denoised=comparison.noise.estimated and not difference_of(comparison.pooling).of_pixel_filter,
        numbers=(numbers[0].text, numbers[1].text) if any(n.coarse for n in numbers) else ("", ""),
        not_numbers=absent,
    )
    return outcome if outcome.same else replace(outcome, spot=_spot(as_found, outcome)), comparison


def _cancelling(
    pooling: Pooling,
    totals: tuple[NDArray[np.float64], NDArray[np.float64]],
    common: Common,
) -> tuple[PooledMean, ...]:
    """Tests of patterns whose means cancel, and of those that need no known noise."""
    steps = pooling.common_step, pooling.rounding
    return all_patterns(difference_of(pooling), totals, pooling.false_alarms, common.cubes, common.apart, *steps)


def _spot(comparison: RegressionData, outcome: Outcome) -> Spot | None:
    """Spot of the difference: in the sum over bands, or in one that shows it more clearly."""
    if all(row.kind in ("numbers", "fixed") for row in outcome.deciding):  # their sentences say where
        return None
    pooling, noise, strata = comparison.pooling, comparison.noise, comparison.strata
    names = comparison.common.baseline.bands
    bands = [row.name for row in outcome.deciding if row.kind == "band"][:1]
    if any(row.kind == "colour" for row in outcome.deciding):
        bands += [name for name in (names[0], names[-1]) if name not in bands]
    # a test of squares knows the place better than noise that is estimated pixel by pixel
    of_means = any(row.kind in MEANS and row.bounds_px is None for row in outcome.deciding)
    squares = [row.bounds_px for row in outcome.deciding if row.bounds_px is not None and not of_means]
    systematic = (pooling.systematic * pooling.level) ** 2
    excess = max(1.0, noise.ratio) if np.isfinite(noise.ratio) else 1.0
    parts = {**strata.surfaces, "the lamp": strata.lamp}
    spots = []
    for band in ("", *bands):
        sums = pooling.band(names.index(band)) if band else pooling.summed
        # variances of few batches, or of few neighbours at a border, may be far too small in single pixels
        variance = excess * np.maximum(sums.variance, smooth_variance(sums.level, sums.variance, noise.degrees))
        pictures = sums.difference, sums.level, variance + systematic * sums.part**2, strata.used
        spots.append(spot_of(*pictures, noise.clustering, parts, band=band, within=squares[0] if squares else None))
    spot = min((spot for spot in spots if spot is not None), key=lambda spot: spot.probability, default=None)
    everywhere = all(row.kind in _EVERYWHERE for row in outcome.deciding)
    return replace(spot, probability=1.0) if spot is not None and everywhere else spot


def _between_cubes(comparison: RegressionData, false_alarms: float) -> tuple[PooledMean, ...]:
    """Tests of blocks and squares between independent cubes; none for sides without them."""
    baseline, candidate = _sides(comparison)
    if baseline.batches is None or candidate.batches is None or comparison.pooling.paired:
        return ()
    floor = float(np.hypot(comparison.pooling.systematic, np.mean(comparison.pooling.interpolation)))
    findings = block_changes(baseline.batches, candidate.batches, comparison.strata.block, floor)
    critical = false_alarms * SHARES["cubes"]
    each = (1 - _RANKED) * critical / max(len(findings), 1)
    blocks = [pool_of_finding("cubes", finding, each) for finding in findings]
    ranked = ranked_squares(baseline.batches.sum(axis=-1), candidate.batches.sum(axis=-1), floor)
    return tuple(blocks) if ranked is None else (*blocks, pool_of_finding("cubes", ranked, _RANKED * critical))


def _layers(baseline: Side, candidate: Side, false_alarms: float) -> tuple[PooledMean, ...]:
    """Tests of the files' layers, which have no noise where they are even."""
    maps = baseline.surfaces, candidate.surfaces
    first, second = (None if m is None or not m.of_objects else (m.index, m.names) for m in maps)
    return certain_layers(changed_layers((baseline.guides, candidate.guides), (first, second)), false_alarms)


def _numbers(side: Side) -> NumberSteps:
    """Numbers that the files of a side hold."""
    values = side.radiance if side.batches is None else side.batches
    return steps_of(values if side.not_numbers is None else values[..., ~side.not_numbers.pixels, :])


def _sides(comparison: RegressionData) -> tuple[Side, Side]:
    """Baseline and candidate."""
    return comparison.common.baseline, comparison.common.candidate


def _total(side: Side) -> NDArray[np.float64]:
    """(y, x) radiance summed over wavelengths."""
    return np.asarray(side.radiance.sum(axis=-1))


def _remarks(comparison: RegressionData) -> list[str]:
    """Notes on maps, equal numbers, pixels without one, and noise that is not as stated."""
    notes = []
    missing, alone = comparison.common.missing, comparison.common.not_numbers
    both = 0 if missing is None else int(missing.sum() - sum(side.pixels.sum() for side in alone.values()))
    if both:
        notes.append(f"pixels that are masked, or are not numbers on both sides: {both}; the rest is compared")
    if comparison.pooling.paired:
        notes.append("both sides have the same random numbers: they are compared cube by cube")
    if comparison.noise.estimated:
        notes.append(f"noise assumed: {_typical_noise(comparison):.2%} of the light per pixel")
    if not comparison.strata.mapped:
        notes.append("no surface map: edges and lamp are found in the picture, and no surface has a name")
    if np.array_equal(comparison.common.candidate.radiance, comparison.common.baseline.radiance):
        notes.append(
            "both sides have the same numbers to the bit. Independent pictures differ by noise, so that a change "
            "between them must be larger to be detected"
        )
    ratio = comparison.noise.ratio
    if np.isfinite(ratio) and ratio > _NOTED_RATIO and not comparison.noise.estimated:
        notes.append(f"neighbouring pixels scatter {np.sqrt(ratio):.2g} times as much as the standard errors say")
    if comparison.noise.clustering > 1:
        notes.append(
            f"neighbouring pixels are correlated: variances of means are {comparison.noise.clustering:.2g} times larger"
        )
    return notes


def _typical_noise(comparison: RegressionData) -> float:
    """Median over the smooth pixels of the difference's standard deviation over the light."""
    used = _quiet(comparison.strata, estimated=True)
    if not used.any():
        return 0.0
    level = comparison.trimmed.level.sum(axis=-1)[used]
    return float(np.median(np.sqrt(comparison.noise.total[used]) / np.maximum(level, 1e-300)))


def _relative(comparison: RegressionData) -> NDArray[np.float64]:
    """(y, x) difference over the baseline, summed over wavelengths; NaN without light."""
    level = comparison.common.baseline.radiance.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(level > 0, comparison.common.candidate.radiance.sum(axis=-1) / level - 1, np.nan)
