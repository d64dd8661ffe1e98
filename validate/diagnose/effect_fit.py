"""Fit of effects that the user selects to one capture or several, with camera and lamp free."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from cboxlab.rendering.chain import after_stage, stages_between
from cboxlab.rendering.effects import AppliedEffect, Effect
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..compare import Validation
from .fitting import fit
from .hypotheses import Hypothesis, hypotheses
from .linearised_fit import linearised_fit
from .search import Candidate, FitProblem, Signature, judged_by_priors, screen, signature
from .selection import NUM_FITTED
from .several_captures import JointFit

__all__ = ["fit_effect", "fit_effects"]

#: Relative error of predicted light transport, of the change by an effect: 1 to 7 % by effect
#: (benchmarks/measured/history.md).
_PREDICTED_TRANSPORT_ERROR = 0.03

#: Numerics: number of times that each of several effects is fitted with the others in place.
_ROUNDS = 2


def fit_effect(
    validation: Validation, effect: Effect, fixed: Mapping[str, str | float], progress: Progress = NO_PROGRESS
) -> tuple[AppliedEffect, float, float]:
    """Fit an effect's parameters to a capture, on top of the model's own effects.

    Parameters
    ----------
    validation
        Validation of the capture.
    effect
        Effect of the catalogue.
    fixed
        By parameter, values that are not fitted.
    progress
        Reports the completed share.

    Returns
    -------
    applied : AppliedEffect
        The effect at the smallest chi2, with standard deviations of the fitted numbers.
    chi2_before : float
        Chi2 per sample without the effect, camera and lamp fitted.
    chi2_after : float
        Chi2 per sample with it, camera and lamp fitted again.

    Raises
    ------
    InputError
        If the effect cannot act on this capture, or has no free number.
    """
    model = validation.model
    linearised = linearised_fit(validation.prepared, validation.rendered, model.effects)
    choices = [p.name for p in effect.parameters if p.choices]
    numbers = {key: value for key, value in fixed.items() if key not in choices}
    possible = [
        replace(
            hypothesis,
            free=tuple(p for p in hypothesis.free if p.name not in numbers),
            fixed={**hypothesis.fixed, **numbers},
            unfitted=tuple(numbers),
        )
        for hypothesis in _hypotheses_of(validation, effect, {k: v for k, v in fixed.items() if k in choices})
    ]
    signatures = [
        signature(linearised.predictor, linearised.model_effects, linearised.rendered.used, h) for h in possible
    ]
    problem, residual = linearised.problem(()), linearised.model.residual
    if not any(signatures) or not any(h.free for h in possible):
        raise _nothing_to_fit(effect.id)
    progress.stage("fitting the effect")
    best = _best_fit(problem, signatures, residual)
    progress.part(1.0)
    applied = AppliedEffect(effect, best.applied.values, _with_shape_error(best, model.effects))
    return applied, linearised.model.chi2 / linearised.model.count, best.chi2 / linearised.model.count


def fit_effects(
    validations: Sequence[Validation],
    effects: Sequence[AppliedEffect],
    fitted_indices: Sequence[int],
    progress: Progress = NO_PROGRESS,
) -> tuple[AppliedEffect, ...]:
    """Fit some of a model's effects to all captures together.

    Numbers are fitted, names stay. Each effect is fitted in turn with the others in place, in the first round also from
    its null value.

    Parameters
    ----------
    validations
        Validations of one model, one per capture.
    effects
        All effects of the model, in order.
    fitted_indices
        Indices into `effects` of those to fit; the others stay as they are.
    progress
        Reports the completed share.

    Returns
    -------
    tuple of AppliedEffect
        All effects in their order, the fitted ones with standard deviations.

    Raises
    ------
    InputError
        If no effect has a free number, or one cannot act on a capture.
    """
    progress.stage("fitting")
    constant = [effect for index, effect in enumerate(effects) if index not in fitted_indices]
    candidates = {index: _candidate(effects[index]) for index in fitted_indices if effects[index].effect.numbers}
    if not candidates:
        raise _nothing_to_fit(", ".join(effects[index].id for index in fitted_indices) or "no effect")
    added = [effects[index] for index in fitted_indices]
    parts = [linearised_fit(v.prepared, v.rendered, constant, added) for v in validations]
    joint = JointFit.of(parts, [v.prepared for v in validations])
    candidates = _fitted_in_turn(validations[0], joint, candidates, progress)
    if not all(np.isfinite(candidate.chi2) for candidate in candidates.values()):
        raise InputError("fit", "an effect that cannot act on this capture", "effects that can")
    rendered = validations[0].model.effects
    fitted = {
        index: AppliedEffect(
            candidate.hypothesis.effect, candidate.applied.values, _with_shape_error(candidate, rendered)
        )
        for index, candidate in candidates.items()
    }
    return tuple(fitted.get(index, effect) for index, effect in enumerate(effects))


def _fitted_in_turn(
    validation: Validation, joint: JointFit, candidates: dict[int, Candidate], progress: Progress
) -> dict[int, Candidate]:
    """Candidates by index, each fitted with the others in place; the first capture's validation."""
    candidates, camera = dict(candidates), joint.parts[0].predictor.camera
    rounds = _ROUNDS if len(candidates) > 1 else 1
    for turn in range(rounds):
        for position, (index, candidate) in enumerate(candidates.items()):
            others = [other for key, other in candidates.items() if key != index]
            problem, residual = joint.problem(others), joint.residual_with(others)
            by_priors = judged_by_priors(candidate.applied, camera)
            fits = [fit(problem, replace(candidate, by_priors=by_priors), residual)]
            if turn == 0:
                fits += _from_null(validation, problem, candidate, residual)
            candidates[index] = min(fits, key=lambda c: c.chi2)
            progress.part((turn * len(candidates) + position + 1) / (rounds * len(candidates)))
    return candidates


def _with_shape_error(candidate: Candidate, rendered: Sequence[AppliedEffect]) -> dict[str, float]:
    """Standard deviations of a fit, with the error of predicted light transport.

    This error is a share of the distance from the number with which the picture was rendered.
    """
    applied, sigma = candidate.applied, dict(candidate.sigma)
    if applied.stage not in stages_between("scene", "transport"):
        return sigma
    before = next((effect.values for effect in rendered if effect.id == applied.id), {})
    for parameter in applied.effect.parameters:
        start = before.get(parameter.name, parameter.null)
        if parameter.name in sigma and start is not None:
            moved = float(applied.values[parameter.name]) - float(start)
            sigma[parameter.name] = float(np.hypot(sigma[parameter.name], _PREDICTED_TRANSPORT_ERROR * moved))
    return sigma


def _nothing_to_fit(identifier: str) -> InputError:
    """The error for an effect without a free number."""
    return InputError("fit", f"{identifier}, which has nothing to fit here", "an effect with a free number")


def _hypotheses_of(validation: Validation, effect: Effect, choices: Mapping[str, str | float]) -> list[Hypothesis]:
    """Hypotheses of an effect in a capture, with some choices made."""
    model, scene = validation.model, validation.prepared.scene
    bands = validation.comparison.bands
    settings = after_stage(model.render, model.effects, "settings")
    return [
        hypothesis
        for hypothesis in hypotheses(bands, scene, settings, [effect])
        if all(hypothesis.fixed[key] == value for key, value in choices.items())
    ]


def _best_fit(problem: FitProblem, signatures: Iterable[Signature | None], residual: np.ndarray) -> Candidate:
    """The best full fit, from the starts that are best to first order."""
    residual = problem.model.project(residual)
    screened = sorted(screen(problem, [s for s in signatures if s is not None], residual), key=lambda c: c.chi2)
    return min((fit(problem, c, residual) for c in screened[:NUM_FITTED]), key=lambda c: c.chi2)


def _from_null(
    validation: Validation, problem: FitProblem, candidate: Candidate, residual: np.ndarray
) -> list[Candidate]:
    """The best fit of an effect from its null value; its names stay. Empty where it cannot act."""
    applied = candidate.applied
    choices = {p.name: applied.values[p.name] for p in applied.effect.parameters if p.choices}
    possible = [hypothesis for hypothesis in _hypotheses_of(validation, applied.effect, choices) if hypothesis.free]
    signatures = [
        Signature(way, tuple(p.coordinate_step for p in way.free), None, candidate.by_priors) for way in possible
    ]
    try:
        return [_best_fit(problem, signatures, residual)] if signatures else []
    except InputError:
        return []


def _candidate(applied: AppliedEffect) -> Candidate:
    """An effect with its current numbers, to be fitted from there."""
    effect = applied.effect
    free = tuple(p for p in effect.numbers if p.null is not None)
    fixed = {p.name: applied.values[p.name] for p in effect.parameters if p not in free}
    numbers = {p.name: float(applied.values[p.name]) for p in effect.numbers}
    return Candidate(Hypothesis(effect, free, fixed), numbers, {}, np.inf, np.zeros(0))
