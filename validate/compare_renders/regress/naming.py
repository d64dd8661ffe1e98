"""Naming of a change: explanations weighed against each other and an unknown cause.

Each explanation costs half the logarithm of the number of data for each parameter (Schwarz 1978). Where even the
best leaves more than noise, log-likelihoods are divided by its remainder per number: a shape that is not quite right
makes all less certain. `unknown` stands for an explanation of most of the difference that is not in the list. Smooth
functions over the picture or over surfaces describe it; they compete with the names, and name nothing.

The goodness of fit then rules the probability of every name. An explanation that leaves more than noise and the known
error of computed shapes is wrong or incomplete, however bad its competitors are. Three tests say so: the sum of what is
left, what further changes explain of it, and the verdict. Further changes are light after each number of reflections,
each surface and slow changes over the picture. A weight that is right for the sum of all light may leave them. The
verdict tests changes of exact shape alone: made in the baseline, they leave nothing that it finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from .causes import Pictures, Trial, causes
from .evidence import Evidence, Fit, build_evidence
from .explanations import FittedChange, from_pictures
from .outcome import UNKNOWN, NamedChange
from .patterns import FIXED_TEXTURE, MEANS, STRUCTURE, alike_along_edges, fine_structure, textures, tile_steps
from .pooled import SHARES, area_means, difference_of
from .sides import Side, SurfaceIndices
from .transport_explanations import coats, from_scene, smooth_over_surfaces
from .variants import Variants
from .verdict import RegressionData, regress_sides
from .view_explanations import from_view, rectangle

__all__ = ["named_changes", "pattern_alone"]

#: Part of the excess that `unknown` explains.
_UNKNOWN_PART = 0.7
#: Parameters that `unknown` costs.
_UNKNOWN_PARAMETERS = 2
#: Most parameters of an explanation that makes looking for a coat needless: those of many imitate one.
_FEW_PARAMETERS = 2
#: Part of the excess that makes looking for a coat needless where it is explained.
_ENOUGH = 0.97
#: Least probability of an explanation that is listed.
_MIN_PROBABILITY = 1e-4
#: Most reflections whose light is a further change by itself; the rest is one more.
_MOST_REFLECTIONS = 6
#: Fewest cells for each further change, from which a fit with all of them says something.
_CELLS_PER_CHANGE = 4
#: Part of ``_SHAPE_ERROR`` and its like that further changes may explain of a name without free amplitudes; each
#: amplitude takes up some of the error. It is 0 to 0.25 for single reflections and depths.
_FURTHER_PART = 0.5
#: Part of the change's chi-square that they may explain of a coat, whose roughness and lobe have steps: 0.03 measured.
_FURTHER_COAT = 0.035
#: Standard deviations of chi-square above its mean that noise explains.
_NOISE_SIGMAS = 2.5
#: Least chi-square per number that noise leaves: generous floors of pixels at edges make it less than 1.
_LEAST_NOISE = 0.25
#: Relative error of the noise of cells: chi-square of right names is 0.8 to 1.1 per cell with stated errors.
_NOISE_ERROR = 0.25
#: Part of a change's chi-square that the error of computed shapes leaves in cells: a tenth of the change itself.
_SHAPE_ERROR = 0.01
#: The same of interpolated pictures, in cells and in single pixels: 0.09 for half a pixel at 48 x 48 pixels.
_SHAPE_ERROR_MOVED = 0.2
#: The same of interpolated spectra, in cells: 0.03 for half a step of 40 nm.
_SHAPE_ERROR_SPECTRUM = 0.06
#: Changes of light after some reflections, whose factor has a cause by itself only with a meaning.
_SHARED = ("counted-light",)
#: Changes of interpolated pictures.
_MOVED = ("shift", "view", "distortion")
#: The same in single pixels: where an edge lies inside of a pixel is known to some hundredths.
_EDGE_ERROR = 0.1
#: Largest probability of names where single pixels scatter by more than noise, which no name explains.
_SCATTERED_CAP = 0.45
#: Scatter that a moved picture carries along, over the fine structure of the baseline: root of 2, and a margin.
_MAX_CARRIED = 2.0
#: Rate at which the verdict refuses a right name by chance.
_REFUSED = 0.01
#: Rate at which what is left at edges refuses a right name by chance. In Mitsuba scenes of 48 to 64 px a sun that moved
#: is below it in 9 of 18 pairs, gains alone in 0 of 15 raw and 2 of 15 denoised ones.
_REFUSED_AT_EDGES = 0.05
#: Misfit of a name in an unknown scene where a part could change by as much unseen: it leaves a probability of 0.8. A
#: sun that moves is channel gains to single pictures of 64 samples; 3 of 4 such names had more than 0.9.
_HIDDEN = 0.7
#: Tests that what is left of a change must pass. Signs of quiet pixels would show the error of a fitted number.
_TESTED = (*MEANS, *STRUCTURE, "pattern")
#: Exponent of the cap on names: a misfit of a half leaves 0.94, of 1 a half, of 2 leaves 0.06.
_CAP_EXPONENT = 4

#: Function that changes pictures (..., y, x, w); those of explanations have an exact shape, whose errors are noise.
_Change = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def named_changes(
    comparison: RegressionData, variants: Variants | None, progress: Progress = NO_PROGRESS
) -> tuple[NamedChange, ...]:
    """Explanations of the difference of two pictures.

    Parameters
    ----------
    comparison
        Sides, parts, noise and outliers of a verdict.
    variants
        Rendering of the scene; None where the scene is unknown.
    progress
        Receiver of the finished part.

    Returns
    -------
    tuple of NamedChange
        Most probable first, with `unknown` among them unless its probability is negligible. The best name is among
        them, unless a pattern that was removed leaves nothing to name.
    """
    evidence = build_evidence(comparison)
    if comparison.removed and not _excess(evidence)[1]:
        return (pattern_alone(comparison.removed),)
    explanations = [*from_pictures(evidence, comparison.common.baseline), *from_view(evidence)]
    pictures = _pictures(comparison, evidence, variants)
    explanations += _of_causes(evidence, pictures, costly=False)
    scatter = _unexplained_scatter(comparison)
    unknown = [_nothing(evidence), *_over_picture(evidence), *filter(None, [rectangle(evidence)])]
    if variants is not None:
        explanations += from_scene(evidence, variants)
        progress.part(0.6)
        if min(e.chi2 for e in explanations if e.free <= _FEW_PARAMETERS) > _target(evidence):
            explanations += coats(evidence, variants)
        few = [e for e in explanations if e.free <= _FEW_PARAMETERS]
        best = min(few, key=lambda e: e.chi2)
        if scatter is None and (best.chi2 > _target(evidence) > 0 or _is_shared(best)):
            explanations += _of_causes(evidence, pictures, costly=True)
        fit, free = smooth_over_surfaces(evidence, variants)
        unknown.append(FittedChange(UNKNOWN, {"description": "smooth over surfaces"}, fit, free))
    if scatter is not None:
        unknown[0] = FittedChange(UNKNOWN, {"description": scatter}, unknown[0].fit, 0)
    further = _further_changes(comparison, evidence, variants)

    surfaces = None if variants is None else variants.surface_map()

    def most(explanation: FittedChange) -> float:
        return _SCATTERED_CAP if scatter else 1.0 if variants is not None else _clear(evidence, explanation.fit)

    def misfit(explanation: FittedChange) -> float:
        by_numbers = _misfit(evidence, explanation, further)
        if by_numbers > 1 or explanation.applied is None:
            return by_numbers
        by_verdict, is_hidden = _by_verdict(comparison, explanation.applied, surfaces)
        by_edges = _by_edges(comparison, evidence, explanation.applied) if is_hidden else 0.0
        return max(by_numbers, by_verdict, _HIDDEN if is_hidden else 0.0, by_edges)

    return _weighed(evidence, explanations, unknown, most, misfit)


def _pictures(comparison: RegressionData, evidence: Evidence, variants: Variants | None) -> Pictures:
    """Pictures as causes take them."""
    baseline, candidate = comparison.common.baseline, comparison.common.candidate
    camera = baseline.camera or candidate.camera
    before, after = (side.radiance[None] if side.batches is None else side.batches for side in (baseline, candidate))
    return Pictures(
        evidence.baseline,
        evidence.candidate,
        (before, after),
        None if baseline.in_colour else baseline.wavelength_nm,
        comparison.noise.total,
        camera if variants is None else variants.camera,
        variants,
        lambda templates, fixed: evidence.fit(templates, fixed).amplitudes,
        lambda templates, fixed: evidence.fit(templates, fixed).chi2,
    )


def _of_causes(evidence: Evidence, pictures: Pictures, costly: bool) -> Iterator[FittedChange]:
    """Explanations by the causes of the catalogue."""
    for cause in causes():
        if cause.costly is not costly or (cause.needs_scene and pictures.scene is None):
            continue
        for trial in cause.trials(pictures):
            fit = evidence.fit(trial.templates, trial.fixed)
            parameters = trial.parameters(fit.amplitudes) if np.isfinite(fit.chi2) else None
            if parameters is not None:
                name = str(parameters.get("effect", cause.id))
                values = {key: value for key, value in parameters.items() if key != "effect"}
                free = len(trial.templates) + trial.selected
                applied = _factor(evidence, trial, fit) if cause.is_factor else None
                yield FittedChange(name, values, fit, free, (cause.shape_error, cause.edge_error), applied)


def _factor(evidence: Evidence, trial: Trial, fit: Fit) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Function that changes pictures by the factor of a trial's pixels."""
    changes = [*(a * t for a, t in zip(fit.amplitudes, trial.templates, strict=True))]
    changes += [] if trial.fixed is None else [trial.fixed]
    light = evidence.baseline.sum(axis=-1, keepdims=True)
    change = np.sum([part.sum(axis=-1, keepdims=True) for part in changes], axis=0)
    factor = 1 + np.divide(change, light, out=np.zeros_like(light), where=light > 0)
    return lambda picture: picture * factor


def _further_changes(comparison: RegressionData, evidence: Evidence, variants: Variants | None) -> NDArray[np.float64]:
    """(n, k) numbers of changes that a name must not leave.

    k is 0 where there are too few cells.
    """
    grouped = evidence.grouped()
    base = grouped.baseline
    rows, columns = (np.linspace(-1, 1, size) for size in base.shape[:2])
    y, x = np.meshgrid(rows, columns, indexing="ij")
    slow = [np.ones_like(x), x, y, x * x, x * y, y * y]
    surfaces = [mask.astype(float) for mask in comparison.strata.surfaces.values()]
    changes = [grouped.features(base * shape[..., None]) for shape in (*slow, *surfaces)]
    if variants is not None:
        until = [variants.light.change(max_bounces=n).picture() for n in range(_MOST_REFLECTIONS + 1)]
        for before, after in pairwise([*until, variants.picture]):
            ratio = variants.ratio(variants.picture + np.maximum(after - before, 0))
            changes.append(evidence.features(evidence.baseline * (ratio - 1)))
    further = np.stack(changes, axis=1)
    enough = further.shape[1] * _CELLS_PER_CHANGE <= evidence.level.size and bool(np.isfinite(further).all())
    return further if enough else further[:, :0]


def pattern_alone(description: str) -> NamedChange:
    """Description of a difference that is a pattern and nothing else.

    Parameters
    ----------
    description
        The pattern.

    Returns
    -------
    NamedChange
        An unknown cause with a description.
    """
    return NamedChange(UNKNOWN, {"description": description}, 1.0)


def _unexplained_scatter(comparison: RegressionData) -> str | None:
    """Texture or tiles in words, which none of the causes makes; None without any."""
    difference, critical = difference_of(comparison.pooling), comparison.pooling.false_alarms * SHARES["texture"]
    carried = _MAX_CARRIED * fine_structure(difference)
    findings = [finding for finding in textures(difference) if finding.name == FIXED_TEXTURE and finding.size > carried]
    steps = tile_steps(difference)
    findings += [] if steps is None else [steps]
    return next((finding.name for finding in findings if finding.probability < critical), None)


def _nothing(evidence: Evidence) -> FittedChange:
    """Description of a difference without a change in means and at edges."""
    return FittedChange(UNKNOWN, {}, evidence.fit([]), 0)


def _over_picture(evidence: Evidence) -> Iterator[FittedChange]:
    """Descriptions of an unknown cause: second-order polynomials of the picture's coordinates."""
    base = evidence.baseline
    rows, columns = (np.linspace(-1, 1, size) for size in base.shape[:2])
    y, x = np.meshgrid(rows, columns, indexing="ij")
    shapes = ([x, y], [x * x + y * y], [x, y, x * x, x * y, y * y])
    for polynomials in shapes:
        fit = evidence.fit([base, *(base * shape[..., None] for shape in polynomials)])
        yield FittedChange(UNKNOWN, {"description": "smooth over the picture"}, fit, 1 + len(polynomials))


def _excess(evidence: Evidence) -> tuple[float, float]:
    """Chi-square without any change, and the part of it that noise does not explain."""
    none = evidence.fit([]).chi2
    return none, max(none - evidence.numbers - _NOISE_SIGMAS * np.sqrt(2 * evidence.numbers), 0.0)


def _clear(evidence: Evidence, fit: Fit) -> float:
    """Largest probability of a name where the scene is unknown.

    Paths, paints and lamps cannot be tried then. One of another shape has to be distinguishable from the name by noise,
    in the part of the picture that the name acts on. Where that is the smaller part, the other part shows the noise.
    """
    others = evidence.numbers - fit.touched
    level = 1.0
    if others > fit.touched:
        level = float(np.clip((evidence.fit([]).chi2 - fit.touched_chi2) / others, _LEAST_NOISE, 1.0))
    count = max(fit.touched, 1)
    noise = _NOISE_SIGMAS * level * np.sqrt(2 * count)
    clear = (1 - _UNKNOWN_PART) * max(fit.touched_chi2 - level * count - noise, 0.0) / noise
    return float((0.5 + clear**2) / (1 + clear**2))


def _is_shared(explanation: FittedChange) -> bool:
    """Whether costly causes may look the same: a factor on late light has many causes."""
    return explanation.change in _SHARED and "meaning" not in explanation.parameters


def _target(evidence: Evidence) -> float:
    """Chi-square below which no further explanation is looked for."""
    none, excess = _excess(evidence)
    return max(none - _ENOUGH * excess, 0.0) if excess else 0.0


def _misfit(evidence: Evidence, explanation: FittedChange, further: NDArray[np.float64]) -> float:
    """Remainder of a fit over that of noise and of the error of shapes; at most 1 where it fits.

    Cells and single pixels are tested separately, since generous floors of many pixels at edges would hide cells. What
    further changes (n, k) explain of the cells is tested by itself.
    """
    none, fit = evidence.fit([]), explanation.fit
    in_cells, in_pixels = _SHAPE_ERROR, _EDGE_ERROR
    if explanation.shape_errors is not None:
        in_cells, in_pixels = explanation.shape_errors
    elif explanation.change in _MOVED:
        in_cells = in_pixels = _SHAPE_ERROR_MOVED
    elif explanation.change == "wavelengths":
        in_cells = _SHAPE_ERROR_SPECTRUM
    cells = evidence.level.size
    pixels, slow = evidence.numbers - cells, further.shape[1]
    explained = evidence.explained_by(further, fit) if slow else 0.0
    amplitudes = 0 if explanation.change in _MOVED else fit.amplitudes.size  # those of moved pictures are their borders
    in_slow = _FURTHER_COAT if explanation.change == "gloss" else _FURTHER_PART * in_cells / (1 + amplitudes)
    parts = [
        (cells, max(none.cells_chi2 - cells, 0.0), fit.cells_chi2, in_cells),
        (pixels, max(none.pixels_chi2 - pixels, 0.0), fit.pixels_chi2, in_pixels),
        (slow, max(none.cells_chi2 - cells, 0.0), explained, in_slow),
    ]
    ratios = [0.0]
    for count, change, after, error in parts:
        allowed = _NOISE_ERROR * count + _NOISE_SIGMAS * np.sqrt(2 * count) + error * change
        if count:
            ratios.append((after - count) / allowed)
    return float(max(ratios))


def _changed(side: Side, change: _Change) -> Side:
    """Side whose pictures (..., y, x, w) a function changed; noise follows its slope."""
    variance, batches = side.variance, None if side.batches is None else change(side.batches)
    if variance is not None:
        sigma = np.sqrt(variance)
        variance = np.square(change(side.radiance + sigma) - change(side.radiance - sigma)) / 4
    radiance = change(side.radiance) if batches is None else batches.mean(axis=0)
    return replace(side, radiance=radiance, variance=variance, batches=batches)


def _by_edges(comparison: RegressionData, evidence: Evidence, applied: _Change) -> float:
    """Misfit by what is left along edges, where a shadow that moved has one sign.

    Floors of single pixels at edges are generous, and sums over cells hide what cancels.
    """
    strata, rest = comparison.strata, (evidence.candidate - applied(evidence.baseline)).sum(axis=-1)
    sigma = np.sqrt(np.maximum(comparison.noise.total, 1e-300))
    sigma[evidence.pixels] = 1 / evidence.scale
    probability = alike_along_edges(rest / sigma, strata.edges, strata.smooth)
    return float(np.log(max(probability, 1e-300)) / np.log(_REFUSED_AT_EDGES))


def _by_verdict(comparison: RegressionData, applied: _Change, surfaces: SurfaceIndices | None) -> tuple[float, bool]:
    """Misfit by the verdict; True where a part of the scene could change by as much unseen.

    The changed baseline has to be the same as the candidate. A sun that moved scales most of the light, and moves
    shadows, too. No list of numbers shows every such trace.
    """
    common, fitted = comparison.common, area_means(comparison.pooling)[0].sigma
    changed = _changed(common.baseline, applied)
    try:
        outcome, _ = regress_sides(changed, common.candidate, surfaces, _REFUSED, fitted)
    except InputError:  # a change after which a tenth of the light is below 0
        return np.inf, False
    quotient = min(row.probability / row.critical for row in outcome.pools if row.kind in _TESTED)
    misfit = float(np.log(np.clip(quotient * _REFUSED, 1e-300, 1.0)) / np.log(_REFUSED))
    before, after = common.baseline.radiance, changed.radiance
    change = (np.abs(after - before) / np.where(before > 0, before, np.inf)).max(axis=-1)
    size = float((change**2).sum() / max(float(change.sum()), 1e-300))
    return misfit, surfaces is None and outcome.would_have_seen_in_parts > size


def _weighed(
    evidence: Evidence,
    explanations: list[FittedChange],
    unknown: list[FittedChange],
    most: Callable[[FittedChange], float],
    misfit: Callable[[FittedChange], float],
) -> tuple[NamedChange, ...]:
    """Explanations with probabilities.

    unknown : descriptions of an unknown cause, "nothing" the first. most : largest probability of a name.
    misfit : what a name leaves over what it may leave.
    """
    none, excess = _excess(evidence)
    cost = np.log(evidence.numbers)
    unknown_chi2 = none - _UNKNOWN_PART * excess
    candidates = [*explanations, *unknown]
    chi2 = np.array([*(e.chi2 for e in candidates), unknown_chi2])
    free = np.array([*(e.free for e in candidates), _UNKNOWN_PARAMETERS])
    softness = max(1.0, float(chi2.min()) / evidence.numbers)
    score = -0.5 * chi2 / softness - 0.5 * cost * free
    score[len(explanations) : -1] -= np.log(max(len(unknown), 1))  # descriptions share the prior of one explanation
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    best = {}
    for change in dict.fromkeys(e.change for e in explanations):
        same = [i for i, e in enumerate(explanations) if e.change == change]
        best[change] = max(same, key=lambda i: score[i]), float(weight[same].sum())
    first = max(best, key=lambda change: score[best[change][0]])
    foremost = explanations[best[first][0]]
    least = misfit(foremost)
    cap = most(foremost) / (1 + least**_CAP_EXPONENT)
    total = sum(share for _, share in best.values())
    factor = min(1.0, cap / total) if total else 1.0
    changes = []
    for change, (index, share) in best.items():
        if factor * share >= _MIN_PROBABILITY or change == first:
            explanation = explanations[index]
            fits = (least if change == first else misfit(explanation)) <= 1
            remainder = explanation.chi2 / evidence.numbers
            changes.append(NamedChange(change, explanation.parameters, factor * share, remainder, fits))
    share = 1 - factor * total
    if share >= _MIN_PROBABILITY:
        described = candidates[len(explanations) + int(np.argmax(score[len(explanations) : -1]))]
        fits = misfit(described) <= 1
        remainder = (described.chi2 if fits else unknown_chi2) / evidence.numbers
        changes.append(NamedChange(UNKNOWN, described.parameters if fits else {}, share, remainder, fits))
    return tuple(sorted(changes, key=lambda n: -n.probability))
