"""Diagnosis of a validation: ranked effects, the path of the falling error, the explanation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.rendering.model import Model
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..compare import Validation
from . import evidence, unexplained
from .alternatives import (
    LikelyCause,
    SelectedEffect,
    groups,
    holds_with_remainder,
    likeliest_causes,
    with_alternatives,
)
from .base_flaws import Flaw
from .evidence import Limit, explained_part, something_remains, square, tolerance_notes
from .explain import (
    LEAST_PROBABILITY,
    SOUND,
    Explanation,
    Lead,
    Signs,
    explain,
    explain_masked_families,
    imitation_probability,
)
from .external_render import ExternalRender, external_render
from .further_captures import Separation, separations
from .hypotheses import LIKELY
from .judgement import (
    BaseFlaws,
    Verdict,
    confirmed_with_flaws,
    cost_in_power,
    flaws_without,
    scores_with_flaws,
    selected_with_flaws,
    settled_with_flaws,
)
from .linearised_fit import (
    LinearisedFit,
    linearised_fit,
    refitted_together,
    residual_with,
    residual_with_rendered,
)
from .results import UNKNOWN, Ranked, Step, path_of, ranking
from .search import Candidate, Signature, without_imitated
from .several_captures import FurtherCaptureResult, further_fit, further_result, refitted_to_all
from .stepwise import Selection, selection, signatures_of, tolerated_changes

__all__ = ["UNKNOWN", "Diagnosis", "Ranked", "diagnose_validation"]


@dataclass(frozen=True, eq=False)
class Diagnosis(FrozenMappings):
    """Effects that a model lacks, and what they leave."""

    #: Whether the model as given is adequate.
    adequate: bool
    #: Chi2 per sample of the model as given, nuisances fitted, errors of the rendering counted.
    chi2_per_dof: float
    #: The same with the selected effects.
    final_chi2_per_dof: float
    #: Every effect tried alone, by probability.
    ranking: tuple[Ranked, ...]
    #: Identifiers of the selected effects in the order added; "unknown" last where something remains.
    selected: tuple[str, ...]
    #: Groups of effects that this capture does not distinguish.
    indistinguishable: tuple[tuple[str, ...], ...]
    #: The model as given, then with one effect more each.
    path: tuple[Step, ...]
    #: Gain in pixels held out over that where fitted, the smallest of all selected effects; NaN where untested.
    heldout_pixels: float
    #: Gain in bands held out over that where fitted, the smallest of all; NaN where untested.
    heldout_bands: float
    #: Captures that would distinguish those groups.
    separations: tuple[Separation, ...]
    #: The model with the selected effects.
    model: Model
    #: (band, y, x) measured minus the model as given, over sigma, without what camera and lamp can imitate; NaN where
    #: not used.
    residual: NDArray[np.float32]
    #: The likeliest causes tried alone, to be compared with `residual`.
    causes: tuple[LikelyCause, ...]
    #: The family of fields that explains what no effect does; None where nothing remains.
    explanation: Explanation | None = None
    #: Light that an external rendering lacks by itself; None for our own.
    render: ExternalRender | None = None
    #: Results for the further captures.
    further: tuple[FurtherCaptureResult, ...] = ()
    #: Amplitude over its standard deviation, the smallest of all selected effects, where rendering errors were counted;
    #: NaN otherwise.
    certainty: float = float("nan")
    #: Detection limit of each effect; empty where something is selected.
    limits: tuple[Limit, ...] = ()
    #: Limits of the prediction that concern this capture, one sentence each.
    notes: tuple[str, ...] = ()
    #: Kinds of flaws of the base next to effects and explanation, the largest first; empty without any.
    flaws: tuple[Flaw, ...] = ()
    #: Factor by which these flaws raise the size that an effect must have to be seen, the median of the catalogue; 1
    #: where it was not computed.
    flaws_cost: float = 1.0
    #: Judgement of every effect next to the base's flaws, those that did not hold included.
    verdicts: tuple[Verdict, ...] = ()
    #: By effect that was selected, or left for it, the form of an unlisted cause that explains as much.
    doubts: Mapping[str, Lead] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Answer(FrozenMappings):
    """Selected effects of a capture, their fit, and the explanation of what they leave."""

    #: The picture with the effects, linearised.
    linearised: LinearisedFit
    #: The effects, fitted together.
    effects: list[Candidate]
    #: The same with their alternatives.
    assessed: list[SelectedEffect]
    #: (n + 11,) projected residual with the effects, over sigma.
    residual: NDArray[np.float64]
    #: Identifiers of the effects; "unknown" last where something remains.
    selected: tuple[str, ...] = ()
    #: Explanation of what remains; None where nothing does.
    explanation: Explanation | None = None
    #: Probability of an unknown cause: where effects are selected, that they only imitate it.
    unknown: float = LEAST_PROBABILITY
    #: By effect, the probability that it only imitates an unknown cause.
    imitations: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Judged(FrozenMappings):
    """Selection by size, and the effects that hold next to the flaws of the base."""

    #: Selection by size alone.
    by_size: Selection
    #: The selection that counts.
    search: Selection
    #: Its effects and their alternatives, those that hold.
    effects: list[Candidate]
    #: The same with their alternatives.
    assessed: list[SelectedEffect]
    #: Flaws of the base that remain with them.
    flaws: BaseFlaws
    #: Judgement of every effect.
    verdicts: tuple[Verdict, ...]
    #: Factor by which flaws raise the size that an effect must have, see `cost_in_power`.
    flaws_cost: float
    #: Identifiers of effects that are no candidates, see `without_imitated`.
    imitated: tuple[str, ...]
    #: By effect, the lead of the best form of an unlisted cause, see `leads_of_forms`.
    leads: Mapping[str, Lead] = field(default_factory=dict)
    #: Largest probability of an imitation among effects that left for it; 0 for none.
    unlisted: float = 0.0


def diagnose_validation(
    validation: Validation, progress: Progress = NO_PROGRESS, further: Sequence[Validation] = ()
) -> Diagnosis:
    """Find the effects of the catalogue that explain a validation's residual.

    Parameters
    ----------
    validation
        Validation of a capture by the model.
    progress
        Reports the completed share.
    further
        Validations of further captures of the same box. They decide between the selected effects and their
        alternatives, and are compared with the resulting model.

    Returns
    -------
    Diagnosis
        Effects, ranking, remainder and explanation.

    Raises
    ------
    InputError
        Without a compiled variant of the engine, which predicts effects.
    """
    validation, render = external_render(validation)
    prepared, model = validation.prepared, validation.model
    first = linearised_fit(prepared, validation.rendered, model.effects)
    start = first.model
    judged = _search(validation, first, progress)
    by_size, search, effects, assessed = judged.by_size, judged.search, judged.effects, judged.assessed
    linearised = search.linearised
    further_fits = [further_fit(validation, other, effects) for other in further]
    if effects and further_fits:
        as_judged = [replace(fit, linearised=search.judging(fit.linearised)) for fit in further_fits]
        assessed = refitted_to_all(prepared, search.judging(linearised), assessed, as_judged)
        effects = [effect.candidate for effect in assessed]
    linearised = linearised if effects else first
    imitations = _imitations(judged, assessed)
    answer = _Answer(linearised, effects, assessed, residual_with(linearised, effects), imitations=imitations)
    progress.stage("explaining what remains")
    answer = _explained(first, answer, judged, prepared.calibration.capture, progress)
    flaws, flaws_cost, explanation = judged.flaws, judged.flaws_cost, answer.explanation
    if explanation is not None and not flaws.small:
        # their fit contained part of that cause, which is in the change also where its family is not named
        flaws, flaws_cost = flaws_without(answer.linearised, answer.residual, explanation.change).base_flaws, 1.0
    path = path_of(validation, start, answer.linearised, answer.effects, judged.imitated)
    progress.part(1.0)
    effect_ids = [c.hypothesis.effect.id for c in answer.effects]
    singles = by_size.singles
    notes = () if answer.selected else tolerance_notes(singles, start.residual, start)
    notes += unexplained.frames_note(answer.linearised, explanation, prepared.calibration.capture)
    return Diagnosis(
        adequate=not answer.selected,
        chi2_per_dof=start.chi2 / start.count,
        final_chi2_per_dof=float(answer.residual @ answer.residual) / answer.linearised.model.count,
        ranking=ranking(
            singles,
            search,
            answer.assessed,
            start,
            answer.unknown,
            answer.imitations,
            answer.selected,
            sound=0.0 if explanation is None else explanation.odds.get(SOUND, 0.0),
        ),
        selected=answer.selected,
        indistinguishable=groups(answer.assessed),
        path=path,
        heldout_pixels=_least([effect.heldout_pixels for effect in answer.assessed]),
        heldout_bands=_least([effect.heldout_bands for effect in answer.assessed]),
        separations=separations(prepared, answer.linearised, answer.assessed),
        model=replace(model, effects=(*model.effects, *(c.applied for c in answer.effects))),
        residual=start.image(start.residual).astype(np.float32),
        causes=likeliest_causes(search.first, search.singles, effect_ids) if answer.selected else (),
        explanation=explanation,
        render=render,
        certainty=_least([] if search.first.errors is None else [effect.certainty for effect in answer.assessed]),
        limits=() if answer.selected else search.limits,
        notes=path[-1].unknown + notes + unexplained.parts_notes(judged.verdicts, judged.leads),
        flaws=flaws.reported,
        flaws_cost=flaws_cost,
        verdicts=judged.verdicts,
        doubts=unexplained.close_leads(judged.leads),
        further=tuple(
            further_result(other, fit, answer.effects) for other, fit in zip(further, further_fits, strict=True)
        ),
    )


def _explained(first: LinearisedFit, answer: _Answer, judged: _Judged, capture: Capture, progress: Progress) -> _Answer:
    """An answer with the explanation of what its effects leave, or of the excess as a whole.

    Where one family explains the excess better than the effects, "unknown" is the whole answer, and the model stays as
    given. What small flaws of the base explain is taken off beforehand, unless something remains then, since their fit
    contains part of such a cause. Next to effects, "unknown" is added where an unlisted cause is likelier than not.
    Without effects it is the answer where a cause is likelier than a sound capture. Next to flaws that stand for what
    remained it always is, since the odds do not know these.
    first : the picture without effects.
    """
    flaws, unlisted = judged.flaws, judged.unlisted
    start, model, residual, effects = first.model, answer.linearised.model, answer.residual, answer.effects
    rendered = residual_with_rendered(answer.linearised, effects)
    change = model.whiten_used(flaws.change_dn) if flaws.small else np.zeros_like(residual)
    remains = something_remains(model, residual, rendered)
    by_flaws = remains and not something_remains(model, residual - change, rendered - change)
    excess = unexplained.residual_data_of(answer.linearised, residual - by_flaws * change, capture)
    best = explain(excess, share(progress, 0.95, 0.97))
    if not remains and flaws.small and best.single_pixels:
        # the same deviations in other words
        by_flaws, excess = True, unexplained.residual_data_of(answer.linearised, residual - change, capture)
        best = explain(excess, share(progress, 0.97, 0.97))
    if by_flaws:
        remains, residual = False, residual - change
        start = replace(start, residual=start.residual - start.whiten_used(flaws.change_dn))
    several, by_effects = (best, *explain_masked_families(excess)), start.chi2 - square(residual)
    beyond = residual  # soft corners that are no remainder are no pattern either
    if flaws.small and not (remains or by_flaws):
        beyond = residual - model.whiten_used(flaws.by_lens_dn)
    explanation = unexplained.explanation_to_report(several, model, beyond, by_effects, remains or unlisted > 0)
    if by_flaws and explanation is not None and explanation.separate:
        explanation = unexplained.at_full_size(explanation, excess, flaws.change_dn)
    selected = tuple(c.hypothesis.effect.id for c in effects)
    by_picture = [c.hypothesis.effect.id for c in effects if not c.by_priors]
    imitations = dict(answer.imitations)
    unknown = max(unlisted, *imitations.values(), LEAST_PROBABILITY)
    if explanation is not None and not (effects or by_flaws) and max(unlisted, best.cause_probability) <= LIKELY:
        return replace(answer, unknown=max(unknown, best.cause_probability))
    if explanation is not None:
        explained = explained_part(start, residual)
        # an imitation of another cause explains a part of it
        remaining = best.cause_probability * (1 - max(explained, 0.0))
        imitations |= {name: max(imitations[name], remaining) for name in by_picture}
        unknown = max(unknown, best.cause_probability)
        hold = holds_with_remainder(answer.assessed, 1.0 if best.single_pixels else explained)  # imitated by none
        next_to_effects = (UNKNOWN,) if unknown > LIKELY else ()
        selected = (*selected, *next_to_effects) if hold else (UNKNOWN,)
    is_large = square(residual) / model.count - 1 > evidence.REMAINS_MIN_SMOOTH_EXCESS
    if by_picture and (explanation is not None or len(effects) > 1 or is_large):
        alone = explain(unexplained.residual_data_of(first, start.residual, capture), share(progress, 0.97, 0.99))
        before_flaws = answer.residual

        def scores(by_family: NDArray[np.float64]) -> tuple[float, float]:
            of_effects, of_family = scores_with_flaws((answer.linearised, before_flaws), (first, by_family))
            return of_effects, of_family

        scoring = scores if flaws.imitated and not by_flaws else None
        beaten = unexplained.family_beats_effects(alone, start, effects, model, residual, explanation, scoring)
        if selected == (UNKNOWN,) or (beaten and not alone.single_pixels):
            explanation, selected = alone, (UNKNOWN,)
    explanation = None if explanation is None else explanation.named_if_likely()
    if selected == (UNKNOWN,):
        unknown = unknown if explanation is None else max(unlisted, explanation.cause_probability)
        return _Answer(first, [], [], first.model.residual, selected, explanation, unknown)
    return replace(answer, selected=selected, explanation=explanation, unknown=unknown, imitations=imitations)


def _imitations(judged: _Judged, assessed: Sequence[SelectedEffect]) -> dict[str, float]:
    """By effect, the probability that it only imitates a cause that nobody listed.

    What the picture shows says nothing about an effect that priors judge.
    """
    verdicts, imitations = {verdict.effect: verdict for verdict in judged.verdicts}, dict[str, float]()
    for effect in assessed:
        name = effect.candidate.hypothesis.effect.id
        imitations[name] = LEAST_PROBABILITY
        if not effect.candidate.by_priors:
            by_size = (effect.chi2_without - effect.candidate.chi2) / effect.count
            lead, verdict = judged.leads[name], verdicts.get(name)
            gain, by_part = (by_size, -np.inf) if verdict is None else (verdict.gain, verdict.by_part.lead)
            heldout = float(np.fmin(effect.heldout_pixels, effect.heldout_bands))
            signs = Signs(gain, effect.count, heldout, lead.lead, lead.frames, by_part)
            imitations[name] = imitation_probability(signs)
    return imitations


def _likelier_than_imitations(
    judged: _Judged, errors: csr_array, signatures: Sequence[Signature], capture: Capture
) -> _Judged:
    """The same without effects that are likelier an imitation of an unlisted cause.

    errors : (n, k) over sigma, errors that samples share and flaws of the base next to the effects.
    """
    search, linearised = judged.search, judged.search.linearised
    judged = replace(judged, leads=unexplained.leads_of_forms(linearised, judged.effects, errors, capture))
    doubtful = {name: p for name, p in _imitations(judged, judged.assessed).items() if p > LIKELY}
    if not doubtful:
        return judged
    rest = [c for c in judged.effects if c.hypothesis.effect.id not in doubtful]
    likely = refitted_together(linearised, rest) if rest else []
    return replace(
        judged,
        effects=likely,
        assessed=with_alternatives(search.judging(linearised), likely, signatures),
        verdicts=tuple(replace(v, holds=v.holds and v.effect not in doubtful) for v in judged.verdicts),
        unlisted=max(doubtful.values()),
    )


def _search(validation: Validation, first: LinearisedFit, progress: Progress) -> _Judged:
    """Effects selected by size, and those that hold in the end.

    It frees the signatures, which take much of the memory.
    """
    progress.stage("trying every effect")
    signatures = signatures_of(first, first.model_effects, validation.model.render, share(progress, 0.0, 0.6))
    signatures, imitated = without_imitated(first.model, first.free_changes, signatures)
    progress.stage("choosing among effects")
    by_size = search = selection(validation, first, signatures, progress)
    effects, fitted_flaws, verdicts = confirmed_with_flaws(search.linearised, search.selected)
    flaws = fitted_flaws.base_flaws
    residual, rendered = (f(search.linearised, search.selected) for f in (residual_with, residual_with_rendered))
    doubtful = flaws.imitated and not all(verdict.holds for verdict in verdicts)
    doubtful |= something_remains(search.linearised.model, residual, rendered)
    if doubtful or (effects and flaws.imitated):
        # effects alone are no answer: all numbers, rivals, and further ones with the base's flaws in the covariance
        linearised = search.linearised if effects else first
        last = [fitted_flaws] if linearised is search.linearised else []
        del fitted_flaws  # the next one is as large
        if doubtful:
            again = selected_with_flaws(validation, linearised, effects, signatures, last.pop() if last else None)
        else:
            again = settled_with_flaws(linearised, effects, last.pop(), verdicts, signatures)
        cost = cost_in_power(first.problem(()), signatures, again.flaws)
        present = {c.hypothesis.effect.id for c in again.selected}
        verdicts = (*again.verdicts, *(v for v in verdicts if not v.holds and v.effect not in present))
        flaws, errors = again.flaws.base_flaws, again.flaws.errors
        search = replace(by_size, linearised=again.linearised)
        judged = _Judged(by_size, search, again.selected, again.assessed, flaws, verdicts, cost, imitated)
        del again  # its columns take much of the memory
        return _likelier_than_imitations(judged, errors, signatures, validation.prepared.calibration.capture)
    errors = fitted_flaws.errors
    del fitted_flaws
    verdicts = tuple(verdict for verdict in verdicts if verdict.holds)
    if not search.selected:
        # nothing large: small effects that are sharp or coloured still differ from rendering errors
        search = selection(validation, first, signatures, progress, tolerated_changes(first, signatures))
        if search.selected:
            effects, fitted_flaws, verdicts = confirmed_with_flaws(search.linearised, search.selected)
            flaws, errors = fitted_flaws.base_flaws, fitted_flaws.errors
            if flaws.imitated and len(effects) < len(search.selected):
                rivals = with_alternatives(search.judging(search.linearised), effects, signatures)
                search = replace(search, selected=effects, assessed=rivals)
    judged = _Judged(by_size, search, search.selected, search.assessed, flaws, verdicts, 1.0, imitated)
    return _likelier_than_imitations(judged, errors, signatures, validation.prepared.calibration.capture)


def _least(gains: Sequence[float]) -> float:
    """The smallest finite gain; NaN for none."""
    return min((gain for gain in gains if np.isfinite(gain)), default=float("nan"))
