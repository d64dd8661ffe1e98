"""Effects of one's own choice fitted to one capture or several, camera and lamp at their best with them."""

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
from .several_captures import JointFit

__all__ = ["fit_effect", "fit_effects"]

#: So many combinations of choices and starting values, the best to first order, are fitted in full.
_FITTED = 3

#: Error of predicted light transport, part of the change (1 to 7 % by effect, see docs/measurements.md).
_PREDICTED = 0.03

#: So often each of several effects is fitted with the others in place.
_ROUNDS = 2


def fit_effect(
    validation: Validation, effect: Effect, given: Mapping[str, str | float], progress: Progress = NO_PROGRESS
) -> tuple[AppliedEffect, float, float]:
    """The effect's parameters at the least chi2 in the capture, on top of the model's own effects.

    given : parameters that are not fitted. Returns the effect, with standard deviations of what was fitted, and chi2
    per sample without and with it, camera and lamp fitted either time.

    Raises InputError where the effect cannot act on this capture, or has nothing to fit.
    """
    model = validation.model
    linearised = linearised_fit(validation.prepared, validation.rendered, model.effects)
    choices = [p.name for p in effect.parameters if p.choices]
    numbers = {key: value for key, value in given.items() if key not in choices}
    possible = [
        replace(
            one,
            free=tuple(p for p in one.free if p.name not in numbers),
            fixed={**one.fixed, **numbers},
            held=tuple(numbers),
        )
        for one in _ways(validation, effect, {k: v for k, v in given.items() if k in choices})
    ]
    known = [signature(linearised.predictor, linearised.given, linearised.rendered.used, h) for h in possible]
    problem, residual = linearised.problem(()), linearised.model.residual
    if not any(known) or not any(h.free for h in possible):
        raise _nothing_to_fit(effect.id)
    progress.stage("fitting the effect")
    best = _best(problem, known, residual)
    progress.part(1.0)
    applied = AppliedEffect(effect, best.applied.values, _with_shape_error(best, model.effects))
    return applied, linearised.model.chi2 / linearised.model.count, best.chi2 / linearised.model.count


def fit_effects(
    validations: Sequence[Validation],
    effects: Sequence[AppliedEffect],
    chosen: Sequence[int],
    progress: Progress = NO_PROGRESS,
) -> tuple[AppliedEffect, ...]:
    """All effects in their order, the chosen ones with their numbers at the least chi2 in all captures together.

    validations : of one model, one per capture. chosen : indices into ``effects``; the others stay as they are. Names
    among an effect's parameters stay, and so do effects that have no number.

    Raises InputError where no chosen effect has a number, or one cannot act on a capture.
    """
    progress.stage("fitting")
    given = [effect for index, effect in enumerate(effects) if index not in chosen]
    candidates = {index: _candidate(effects[index]) for index in chosen if effects[index].effect.numbers}
    if not candidates:
        raise _nothing_to_fit(", ".join(effects[index].id for index in chosen) or "no effect")
    parts = [linearised_fit(v.prepared, v.rendered, given, [effects[index] for index in chosen]) for v in validations]
    joint = JointFit.of(parts, [v.prepared for v in validations])
    camera = joint.parts[0].predictor.camera
    rounds = _ROUNDS if len(candidates) > 1 else 1
    for turn in range(rounds):
        for place, (index, candidate) in enumerate(candidates.items()):
            others = [other for key, other in candidates.items() if key != index]
            problem, residual = joint.problem(others), joint.residual_with(others)
            found = [
                fit(
                    problem,
                    replace(candidate, by_priors=judged_by_priors(candidate.applied, camera)),
                    residual,
                )
            ]
            if turn == 0:
                found += _from_null(validations[0], problem, candidate, residual)
            candidates[index] = min(found, key=lambda one: one.chi2)
            progress.part((turn * len(candidates) + place + 1) / (rounds * len(candidates)))
    if not all(np.isfinite(one.chi2) for one in candidates.values()):
        raise InputError("fit", "an effect that cannot act on this capture", "effects that can")
    fitted = {
        index: AppliedEffect(
            one.hypothesis.effect, one.applied.values, _with_shape_error(one, validations[0].model.effects)
        )
        for index, one in candidates.items()
    }
    return tuple(fitted.get(index, effect) for index, effect in enumerate(effects))


def _with_shape_error(found: Candidate, rendered: Sequence[AppliedEffect]) -> dict[str, float]:
    """Standard deviations of a fit with the error of light transport that is predicted and not rendered, a part of the
    distance from what the picture was rendered with."""
    applied, sigma = found.applied, dict(found.sigma)
    if applied.stage not in stages_between("scene", "transport"):
        return sigma
    before = next((effect.values for effect in rendered if effect.id == applied.id), {})
    for one in applied.effect.parameters:
        start = before.get(one.name, one.null)
        if one.name in sigma and start is not None:
            moved = float(applied.values[one.name]) - float(start)
            sigma[one.name] = float(np.hypot(sigma[one.name], _PREDICTED * moved))
    return sigma


def _nothing_to_fit(identifier: str) -> InputError:
    return InputError("fit", f"{identifier}, of which nothing can be fitted here", "an effect with a free number")


def _ways(validation: Validation, effect: Effect, choices: Mapping[str, str | float]) -> list[Hypothesis]:
    """The ways in which an effect can act in a capture, with these choices made."""
    model, scene = validation.model, validation.prepared.scene
    bands = validation.comparison.bands
    settings = after_stage(model.render, model.effects, "settings")
    return [
        one
        for one in hypotheses(bands, scene, settings, [effect])
        if all(one.fixed[key] == value for key, value in choices.items())
    ]


def _best(problem: FitProblem, known: Iterable[Signature | None], residual: np.ndarray) -> Candidate:
    """The best fit, from the starts that are best to first order."""
    residual = problem.model.project(residual)
    screened = sorted((screen(problem, s, residual) for s in known if s is not None), key=lambda c: c.chi2)
    return min((fit(problem, c, residual) for c in screened[:_FITTED]), key=lambda c: c.chi2)


def _from_null(
    validation: Validation, problem: FitProblem, candidate: Candidate, residual: np.ndarray
) -> list[Candidate]:
    """The best fit of an effect from its null value instead of the numbers at hand, its names as they are."""
    applied = candidate.applied
    choices = {p.name: applied.values[p.name] for p in applied.effect.parameters if p.choices}
    ways = [one for one in _ways(validation, applied.effect, choices) if one.free]
    known = [Signature(way, tuple(p.coordinate_step for p in way.free), None, candidate.by_priors) for way in ways]
    try:
        return [_best(problem, known, residual)] if known else []
    except InputError:
        return []


def _candidate(applied: AppliedEffect) -> Candidate:
    """An effect with the numbers that it has, to be fitted from there."""
    effect = applied.effect
    free = tuple(p for p in effect.numbers if p.null is not None)
    fixed = {p.name: applied.values[p.name] for p in effect.parameters if p not in free}
    numbers = {p.name: float(applied.values[p.name]) for p in effect.numbers}
    return Candidate(Hypothesis(effect, free, fixed), numbers, {}, np.inf, np.zeros(0))
