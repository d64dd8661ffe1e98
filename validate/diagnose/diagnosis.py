"""Which physical effect does the model lack? From a validation to ranked effects and the path of the falling error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import Model
from cboxlab.utils.frozen import OwnMappings
from cboxlab.utils.progress import QUIET, Progress, share
from numpy.typing import NDArray

from ..compare import Comparison, Validation, compared
from .alternatives import Cause, SelectedEffect, groups, likeliest_causes
from .evidence import (
    LEAST_EXPLAINED,
    SHAPE_ERROR,
    Limit,
    explained_part,
    penalised,
    prior_pull,
    something_remains,
    square,
)
from .explain import Explanation, explain, explain_masked_families
from .foreign_side import ForeignSide, foreign_side
from .further_captures import Separation, separations
from .linear_model import LinearModel, smooth_excess
from .linearised_fit import (
    LinearisedFit,
    linearised_fit,
    refitted_together,
    residual_with,
    residual_with_rendered,
)
from .search import Candidate
from .several_captures import FurtherFit, same_camera, settled
from .stepwise import Selection, refitted, selection, signatures_of, tolerated_changes
from .unexplained import excess_of, explanation_to_report, family_beats_effects

__all__ = ["UNKNOWN", "Diagnosis", "FurtherCaptureFound", "Ranked", "Step", "diagnose"]

#: What is selected where something remains that no effect of the catalogue explains.
UNKNOWN = "unknown"

#: Where one effect leaves more chi2 per sample than this above noise, one family is tried in its stead.
_WORTH_A_FAMILY = 0.03

#: Probability that nothing is missing where no effect was accepted.
NOTHING_MISSING = 0.95


@dataclass(frozen=True)
class Ranked(OwnMappings):
    """One effect tried alone. values : its parameters. sigma : standard deviations of those fitted."""

    effect: str
    values: Mapping[str, str | float]
    sigma: Mapping[str, float]
    chi2_per_dof: float
    probability: float


@dataclass(frozen=True, eq=False)
class Step(OwnMappings):
    """The model with the first effects selected. effects : these. sigma : standard deviations of their numbers.

    smooth_excess : see ``linear_model``. prior_pull : standard deviations by which the fitted camera and lamp miss what
    is known of them. comparison : measured against this model, camera and lamp fitted.
    """

    effects: tuple[AppliedEffect, ...]
    sigma: tuple[Mapping[str, float], ...]
    smooth_excess: float
    prior_pull: float
    comparison: Comparison


@dataclass(frozen=True)
class FurtherCaptureFound:
    """Another capture of the box: chi2 per sample of the model as given and with the effects found, and whether
    anything remains that they do not explain. same_camera : whether it states the same sensor, lens and filters."""

    capture: str
    same_camera: bool
    chi2_per_dof: float
    final_chi2_per_dof: float
    adequate: bool


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a model lacks.

    adequate : whether the model as given is. ranking : every effect tried alone, best first. selected :
    effects in the order added, "unknown" last where something remains. chi2_per_dof, final_chi2_per_dof : of
    the model as given and with the selected effects, nuisances fitted, the base picture's own error counted.
    indistinguishable : groups this capture cannot separate. heldout_pixels, heldout_bands : gain where held out
    from the fit over that where fitted, the least of all selected effects; NaN where it cannot be tried.
    separations : the captures that would separate those groups. model : the given one with the selected effects.
    residual : (band, y, x) measured less the model as given, over sigma, without what camera and lamp can imitate; NaN
    where not used. causes : the likeliest ones tried alone, to be seen beside it.
    explanation : what a family of fields says about what no effect explains; None where nothing remains.
    render : what another renderer's picture lacks by itself; None for our own. further : the other captures asked.
    certainty : amplitude over its standard deviation, the least of all effects found, where they are so small that the
    picture's own errors had to be counted; NaN otherwise. limits : where nothing was found, the smallest size at which
    each effect would have been.
    """

    adequate: bool
    chi2_per_dof: float
    final_chi2_per_dof: float
    ranking: tuple[Ranked, ...]
    selected: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    path: tuple[Step, ...]
    heldout_pixels: float
    heldout_bands: float
    separations: tuple[Separation, ...]
    model: Model
    residual: NDArray[np.float32]
    causes: tuple[Cause, ...]
    explanation: Explanation | None = None
    render: ForeignSide | None = None
    further: tuple[FurtherCaptureFound, ...] = ()
    certainty: float = float("nan")
    limits: tuple[Limit, ...] = ()


def diagnose(validation: Validation, progress: Progress = QUIET, further: Sequence[Validation] = ()) -> Diagnosis:
    """Find which effects of the catalogue explain a validation's residual.

    further : of other captures of the same box. They decide between the effects found and those that could stand in
    their stead, and are compared with the model found.
    Raises InputError where nothing could be compiled and so nothing can be predicted.
    """
    validation, render = foreign_side(validation)
    prepared, model = validation.prepared, validation.model
    first = linearised_fit(prepared, validation.rendered, model.effects)
    start = first.model
    by_size, found = _searched(validation, first, progress)
    linearised, chosen, known = found.linearised, found.chosen, found.known
    others = [_further_fit(validation, one, chosen) for one in further]
    if chosen and others:
        as_judged = [replace(one, linearised=found.judging(one.linearised)) for one in others]
        known = settled(prepared, found.judging(linearised), known, as_judged)
        chosen = [one.candidate for one in known]
    if not chosen:
        linearised = first
    residual = residual_with(linearised, chosen)
    left = something_remains(linearised.model, residual, residual_with_rendered(linearised, chosen))
    progress.stage("explaining what remains")
    capture = prepared.calibration.capture
    excess = excess_of(linearised, residual, capture)
    remains, by_effects = explain(excess, share(progress, 0.95, 0.97)), start.chi2 - square(residual)
    explanation = explanation_to_report(
        (remains, *explain_masked_families(excess)), linearised.model, residual, by_effects, left
    )
    left = explanation is not None
    selected = tuple(c.hypothesis.effect.id for c in chosen)
    if left:
        enough = explained_part(linearised.model, residual) > LEAST_EXPLAINED
        selected = (*selected, UNKNOWN) if selected and enough else (UNKNOWN,)
    rest = square(residual) / linearised.model.count - 1
    if chosen and (left or len(chosen) > 1 or rest > _WORTH_A_FAMILY):
        whole = explain(excess_of(first, start.residual, capture), share(progress, 0.97, 0.99))
        if selected == (UNKNOWN,) or family_beats_effects(
            whole, start, chosen, linearised.model, residual, explanation
        ):
            explanation, selected, left = whole, (UNKNOWN,), True
    if selected == (UNKNOWN,):
        linearised, chosen, known, residual = first, [], [], start.residual
    added = tuple(c.applied for c in chosen)
    steps = [Step((), (), smooth_excess(start, start.residual), prior_pull(start.residual), validation.comparison)]
    for count in range(1, len(chosen) + 1):
        steps.append(
            _step(
                validation,
                linearised,
                refitted_together(linearised, chosen[:count]) if count < len(chosen) else chosen,
            )
        )
    progress.part(1.0)
    return Diagnosis(
        adequate=not selected,
        chi2_per_dof=start.chi2 / start.count,
        final_chi2_per_dof=float(residual @ residual) / linearised.model.count,
        ranking=_ranking(by_size.singles, found, known, start, left, selected),
        selected=selected,
        indistinguishable=groups(known),
        path=tuple(steps),
        heldout_pixels=_least([p.heldout_pixels for p in known]),
        heldout_bands=_least([p.heldout_bands for p in known]),
        separations=separations(prepared, linearised, known),
        model=replace(model, effects=(*model.effects, *added)),
        residual=start.image(start.residual).astype(np.float32),
        causes=likeliest_causes(found.first, found.singles, [c.hypothesis.effect.id for c in chosen])
        if selected
        else (),
        explanation=explanation,
        render=render,
        certainty=_least([] if found.first.errors is None else [one.certainty for one in known]),
        limits=() if selected else found.limits,
        further=tuple(_found_in(one, fit_, chosen) for one, fit_ in zip(further, others, strict=True)),
    )


def _searched(validation: Validation, first: LinearisedFit, progress: Progress) -> tuple[Selection, Selection]:
    """The effects selected by size, and those found in the end. The signatures, much of the memory, end here."""
    start = first.model
    progress.stage("trying every effect")
    signatures = signatures_of(first, first.given, validation.model.render, share(progress, 0.0, 0.6))
    progress.stage("choosing among effects")
    found = by_size = selection(validation, first, signatures, progress)
    if not found.chosen and not something_remains(start, start.residual, start.residual):
        # nothing large: what is small, but sharp or coloured, may still be told from the picture's own errors
        found = selection(validation, first, signatures, progress, tolerated_changes(first, signatures))
    return by_size, found


def _further_fit(validation: Validation, other: Validation, chosen: Sequence[Candidate]) -> FurtherFit:
    """Another capture's picture, rendered and linearised with the effects found in the first one."""
    plain = linearised_fit(other.prepared, other.rendered, other.model.effects)
    there = refitted(other, plain, chosen) if chosen else plain
    captures = (v.prepared.calibration.capture for v in (validation, other))
    return FurtherFit(other.prepared, there, same_camera(*captures))


def _found_in(other: Validation, found: FurtherFit, chosen: Sequence[Candidate]) -> FurtherCaptureFound:
    linearised = found.linearised
    before, residual = linearised.model.residual, residual_with(linearised, chosen)
    rendered = residual_with_rendered(linearised, chosen)
    return FurtherCaptureFound(
        capture=other.prepared.calibration.capture.folder.name,
        same_camera=found.camera_shared,
        chi2_per_dof=square(before) / linearised.model.count,
        final_chi2_per_dof=square(residual) / linearised.model.count,
        adequate=not something_remains(linearised.model, residual, rendered),
    )


def _least(gains: Sequence[float]) -> float:
    return min((gain for gain in gains if np.isfinite(gain)), default=float("nan"))


def _step(validation: Validation, linearised: LinearisedFit, chosen: Sequence[Candidate]) -> Step:
    """The model with these effects, compared; the lamp's scale is fitted with them in place."""
    prepared, rendered, residual = validation.prepared, linearised.rendered, residual_with(linearised, chosen)
    applied = tuple(c.applied for c in chosen)
    signal = linearised.predictor.signal((*linearised.given, *applied))
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, _ = prepared.lamp_scale(signal, variance, rendered.used)
    return Step(
        effects=applied,
        sigma=tuple(dict(c.sigma) for c in chosen),
        smooth_excess=smooth_excess(linearised.model, residual),
        prior_pull=prior_pull(residual),
        comparison=compared(prepared, rendered, scale * signal),
    )


def _ranking(
    by_size: Sequence[Candidate],
    found: Selection,
    known: Sequence[SelectedEffect],
    start: LinearModel,
    left: bool,
    selected: tuple[str, ...],
) -> tuple[Ranked, ...]:
    """The selected effects by the chi2 that leaving them out costs, then their alternatives, then all others.

    A selected effect and its alternatives share the probability among them. Where no effect was selected, that
    nothing is missing has NOTHING_MISSING of it.
    """
    singles = found.singles
    # chi2 of the model as given less the gain, in whatever covariance the gain was found
    counted = start.chi2 - found.first.chi2
    unknown = 0.9 if selected == (UNKNOWN,) else 0.3 if left else 0.02
    entries = {c.hypothesis.effect.id: _ranked(c, 0.0, start.count, 0.0) for c in by_size}
    entries |= {c.hypothesis.effect.id: _ranked(c, counted, start.count, 0.0) for c in singles}
    if set(selected) - {UNKNOWN}:
        for effect in sorted(known, key=lambda e: e.chi2_without):
            everyone = [effect.candidate, *effect.alternatives]
            shares = _shares(everyone, effect.chi2_without, effect.dispersion)
            for candidate, share in zip(everyone, shares, strict=True):
                entry = _ranked(candidate, counted, effect.count, (1 - unknown) * share)
                other = entries.get(entry.effect)
                if candidate is effect.candidate or other is None or entry.probability > other.probability:
                    entries[entry.effect] = entry
    else:
        rest = 1 - unknown if selected else 1 - unknown - NOTHING_MISSING
        for candidate, share in zip(singles, _shares(singles, found.first.chi2, 1.0), strict=True):
            entries[candidate.hypothesis.effect.id] = _ranked(candidate, counted, start.count, rest * share)
    lowest = min((counted + c.chi2 for c in singles), default=start.chi2)
    entries[UNKNOWN] = Ranked(UNKNOWN, {}, {}, lowest / start.count, unknown)
    return tuple(sorted(entries.values(), key=lambda r: (-r.probability, r.chi2_per_dof)))


def _ranked(candidate: Candidate, counted: float, count: int, probability: float) -> Ranked:
    values, sigma = dict(candidate.applied.values), dict(candidate.sigma)
    return Ranked(candidate.hypothesis.effect.id, values, sigma, (counted + candidate.chi2) / count, probability)


def _shares(candidates: Sequence[Candidate], chi2_without: float, dispersion: float) -> list[float]:
    """Probabilities from the differences of chi2, each number at its price; the error of the effects' shapes may make a
    part of them."""
    chi2 = np.array([penalised(c) for c in candidates])
    weights = np.exp(-0.5 * (chi2 - chi2.min()) / (dispersion + SHAPE_ERROR * max(chi2_without - chi2.min(), 0.0)))
    return [float(w) for w in weights / weights.sum()]
