"""Which physical effect does the model lack? Screening, fitting, forward and backward selection, and when to say unknown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.render.bands import render_bands
from cboxlab.render.final_gather import LightField
from cboxlab.render.image import RenderedImage
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from .effects import AppliedEffect
from .hypotheses import hypotheses
from .linear_model import LinearModel, build_linear_model, model_variance, smooth_excess
from .nuisances import NuisanceFit, camera_jacobian
from .predictor import Predictor, build_predictor
from .search import Candidate, Problem, Signature, fit, problem, screen, signature
from .sensing import sensing

__all__ = ["UNKNOWN", "Diagnosis", "Ranked", "Step", "diagnose_residual"]

UNKNOWN = "unknown"

#: An effect must lower chi2 per sample by this much: below it, the base picture's own flaws could do the same.
SMALLEST_GAIN = 0.012

#: Effects that only the priors speak against (they imitate a nuisance): gain in chi2 needed, per free number.
_PRIOR_EFFECTS = ("camera-pose", "lens-distortion", "lamp-power")
_PRIOR_GAIN = 25.0

#: Block means may exceed noise by this much of chi2 per sample before something is said to remain, and by this
#: part of what they exceeded it by at first (the error of the effects' own shapes).
_REMAINS, _REMAINS_PART = 0.012, 0.1

#: Below this part of the excess, what one effect explains may be a coincidence of shapes.
_MOST_OF_IT = 0.8

#: Two effects whose fits differ by less than this in chi2 cannot be told apart (odds of about 100 to 1).
_INDISTINGUISHABLE = 9.2

_MOST_EFFECTS = 3
_REFINED = 6


@dataclass(frozen=True)
class Ranked:
    """One effect tried alone. values : its parameters. sigma : standard deviations of those fitted."""

    effect: str
    values: dict[str, str | float]
    sigma: dict[str, float]
    chi2_per_dof: float
    probability: float


@dataclass(frozen=True, eq=False)
class Step:
    """One model on the way. residual : (band, y, x) over sigma, camera and lamp at their best."""

    effects: tuple[AppliedEffect, ...]
    sigma: tuple[dict[str, float], ...]
    chi2_per_dof: float
    smooth_excess: float
    residual: NDArray[np.float64]
    signal: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """adequate : whether the model as given is. selected : effects in the order added, "unknown" last where
    something remains. heldout_gain : part of the last gain that shows in pixels held out from the fit."""

    adequate: bool
    ranking: tuple[Ranked, ...]
    selected: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    path: tuple[Step, ...]
    heldout_gain: float


@dataclass(frozen=True, eq=False)
class _State:
    """Predictor and linear model about the current camera."""

    predictor: Predictor
    model: LinearModel
    scale: float


def build_state(
    measured: NDArray, calibration, light: LightField, image: RenderedImage, fit_: NuisanceFit, calibrated: Camera,
    lamp_sigma: float | None, settings, usable: NDArray, effects: Sequence[AppliedEffect] = (),
) -> _State:  # fmt: skip
    """The problem linearised about the fitted camera; ``effects`` are in the model as given."""
    predictor = build_predictor(light, image, fit_.camera, sensing(calibration, fit_.camera), settings)
    base = predictor.signal(effects)
    bands = render_bands(image, calibration.responses)
    used = usable & (bands.mask.values == 0)
    variance = calibration.predicted_variance(base) + bands.variance.values + model_variance(base)
    derivative = camera_jacobian(predictor.warp, fit_.camera)
    model = build_linear_model(measured, base, variance, used, derivative, fit_, calibrated, lamp_sigma)
    return _State(predictor, model, fit_.lamp_scale)


def diagnose_residual(
    state: _State, given: Sequence[AppliedEffect], bands: tuple[str, ...], truncated: bool,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:  # fmt: skip
    """Find what the residual of ``state`` is made of."""
    report = progress or (lambda part: None)
    predictor, model = state.predictor, state.model
    scene = predictor.scene
    known = hypotheses(bands, tuple(scene.materials), tuple(s.name for s in scene.surfaces), truncated)
    signatures = []
    for index, hypothesis in enumerate(known):
        found = signature(predictor, model.used, hypothesis)
        if found is not None:
            signatures.append(found)
        report(0.6 * (index + 1) / len(known))
    first_excess = smooth_excess(model, model.residual)
    task = problem(predictor, model, given, state.scale)
    singles = _best_singles(task, signatures, model.residual, _REFINED)
    report(0.8)
    steps = [_step(state, (), given, model.residual)]
    chosen: list[Candidate] = []
    heldout = float("nan")
    candidates, residual = singles, model.residual
    while candidates and len(chosen) < _MOST_EFFECTS:
        best = candidates[0]
        before = float(residual @ residual)
        if not _worth(best, before, model.count):
            break
        heldout = _heldout_gain(model, residual, best.predicted)
        if heldout < 0.5:
            break
        chosen = _refitted(state, given, [*chosen, best])
        residual = _left(state, given, chosen)
        steps.append(_step(state, chosen, given, residual))
        report(0.8 + 0.2 * len(chosen) / _MOST_EFFECTS)
        taken = {c.hypothesis.effect.id for c in chosen}
        task = problem(predictor, model, (*given, *(c.applied for c in chosen)), state.scale)
        rest = [s for s in signatures if s.hypothesis.effect.id not in taken]
        candidates = _best_singles(task, rest, residual, 3)
    chosen, steps = _without_idle(state, given, chosen, steps)
    residual = _left(state, given, chosen) if chosen else model.residual
    remains = _remains(model, residual, first_excess)
    selected = tuple(c.hypothesis.effect.id for c in chosen)
    floor = min(float(residual @ residual), model.chi2)
    explained = _explained(singles, model.chi2, floor)
    if remains:
        selected = (*selected, UNKNOWN) if selected and explained > _MOST_OF_IT else (UNKNOWN,)
    adequate = not selected
    report(1.0)
    return Diagnosis(
        adequate=adequate,
        ranking=_ranking(singles, model, remains, selected),
        selected=selected,
        indistinguishable=_groups(singles, model) if selected and selected != (UNKNOWN,) else (),
        path=tuple(steps),
        heldout_gain=heldout,
    )


def _best_singles(task: Problem, signatures: Sequence[Signature], residual: NDArray, refined: int) -> list[Candidate]:
    """Candidates, the best hypothesis of every effect, best first; the most promising fitted in full."""
    best: dict[str, Candidate] = {}
    for candidate in sorted((screen(task, s, residual) for s in signatures), key=_penalised):
        best.setdefault(candidate.hypothesis.effect.id, candidate)
    ranked = sorted(best.values(), key=_penalised)
    done = [fit(task, candidate, residual) for candidate in ranked[:refined]]
    return sorted([*done, *ranked[refined:]], key=_penalised)


def _penalised(candidate: Candidate) -> float:
    return candidate.chi2 + _INDISTINGUISHABLE / 2 * len(candidate.hypothesis.free)


def _worth(candidate: Candidate, before: float, count: int) -> bool:
    gain = before - candidate.chi2
    if candidate.hypothesis.effect.id in _PRIOR_EFFECTS:
        return gain > _PRIOR_GAIN * max(1, len(candidate.hypothesis.free)) ** 0.5 + 10
    return gain > SMALLEST_GAIN * count


def _heldout_gain(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain per pixel in blocks held out from the amplitude's fit, over that in the others; 1 is perfect."""
    rows, columns = np.nonzero(np.ones(model.used.shape[1:], bool))
    board = ((rows // 16 + columns // 16) % 2).reshape(model.used.shape[1:]).astype(bool)
    one = np.broadcast_to(board, model.used.shape)[model.used]
    halves = []
    for part in (one, ~one):
        inside = np.append(part, np.ones(11, bool))
        outside = np.append(~part, np.zeros(11, bool))
        amplitude = (predicted[inside] @ residual[inside]) / max(predicted[inside] @ predicted[inside], 1e-30)
        left = residual - amplitude * predicted
        own = np.sum(residual[inside] ** 2 - left[inside] ** 2)
        other = np.sum(residual[outside] ** 2 - left[outside] ** 2)
        halves.append((own, other))
    return float(sum(other for _, other in halves) / max(sum(own for own, _ in halves), 1e-30))


def _refitted(state: _State, given: Sequence[AppliedEffect], chosen: list[Candidate]) -> list[Candidate]:
    """All chosen effects' numbers fitted in turn, twice, when there are several."""
    if len(chosen) == 1:
        return chosen
    current = list(chosen)
    for _ in range(2):
        for index, candidate in enumerate(current):
            others = [*given, *(c.applied for i, c in enumerate(current) if i != index)]
            task = problem(state.predictor, state.model, others, state.scale)
            left = state.model.residual - state.model.whiten(state.scale * (task.base - _base(state, given)))
            start = replace(candidate, predicted=np.zeros_like(left))
            current[index] = fit(task, start, left)
    return current


def _base(state: _State, given: Sequence[AppliedEffect]) -> NDArray:
    return state.predictor.signal(given)


def _left(state: _State, given: Sequence[AppliedEffect], chosen: Sequence[Candidate]) -> NDArray:
    change = state.predictor.signal((*given, *(c.applied for c in chosen))) - _base(state, given)
    return state.model.residual - state.model.whiten(state.scale * change)


def _step(state: _State, chosen: Sequence[Candidate], given: Sequence[AppliedEffect], residual: NDArray) -> Step:
    applied = tuple(c.applied for c in chosen)
    return Step(
        effects=applied,
        sigma=tuple(dict(c.sigma) for c in chosen),
        chi2_per_dof=float(residual @ residual) / state.model.count,
        smooth_excess=smooth_excess(state.model, residual),
        residual=state.model.image(residual),
        signal=state.scale * state.predictor.signal((*given, *applied)),
    )


def _without_idle(
    state: _State, given: Sequence[AppliedEffect], chosen: list[Candidate], steps: list[Step]
) -> tuple[list[Candidate], list[Step]]:
    """Backward elimination: an effect that the later ones made superfluous goes."""
    while len(chosen) > 1:
        full = _left(state, given, chosen)
        costs = []
        for index in range(len(chosen)):
            rest = _refitted(state, given, [c for i, c in enumerate(chosen) if i != index])
            left = _left(state, given, rest)
            costs.append((float(left @ left - full @ full), index, rest, left))
        cost, index, rest, left = min(costs, key=lambda item: item[0])
        if cost > SMALLEST_GAIN * state.model.count or chosen[index].hypothesis.effect.id in _PRIOR_EFFECTS:
            break
        chosen = rest
        steps = [steps[0], *(_step(state, chosen[: k + 1], given, _left(state, given, chosen[: k + 1])) for k in range(len(chosen)))]
    return chosen, steps


def _remains(model: LinearModel, residual: NDArray, first_excess: float) -> bool:
    return smooth_excess(model, residual) > max(_REMAINS, _REMAINS_PART * first_excess)


def _explained(singles: Sequence[Candidate], start: float, floor: float) -> float:
    """Part of the explicable excess that the best single effect explains."""
    return (start - singles[0].chi2) / max(start - floor, 1e-9) if singles else 0.0


def _ranking(singles: Sequence[Candidate], model: LinearModel, remains: bool, selected: tuple[str, ...]) -> tuple[Ranked, ...]:
    """Probabilities from chi2, softened by the error of the effects' shapes (a hundredth of the gain)."""
    best = min((c.chi2 for c in singles), default=model.chi2)
    softness = 1.0 + 0.01 * max(model.chi2 - best, 0.0)
    weights = np.exp(-0.5 * np.array([c.chi2 - best for c in singles]) / softness)
    unknown = 0.9 if selected == (UNKNOWN,) else 0.3 if remains else 0.02
    weights = (1 - unknown) * weights / weights.sum()
    entries = [
        Ranked(c.hypothesis.effect.id, dict(c.applied.values), dict(c.sigma), c.chi2 / model.count, float(w))
        for c, w in zip(singles, weights, strict=True)
    ]
    entries.append(Ranked(UNKNOWN, {}, {}, best / model.count, unknown))
    return tuple(sorted(entries, key=lambda r: -r.probability))


def _groups(singles: Sequence[Candidate], model: LinearModel) -> tuple[tuple[str, ...], ...]:
    """The best effect together with those whose fitted predictions this capture cannot tell from it."""
    best = singles[0]
    same = [
        c.hypothesis.effect.id
        for c in singles[1:]
        if c.chi2 - best.chi2 < _INDISTINGUISHABLE and float(np.sum((c.predicted - best.predicted) ** 2)) < 4 * _INDISTINGUISHABLE
    ]
    return ((best.hypothesis.effect.id, *same),) if same else ()
