"""Which physical effect does the model lack? From a validation to ranked effects and the path of the falling error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.render import variant
from cboxlab.scenes.errors import InputError

from .compare import Comparison
from .effects import AppliedEffect
from .forward import after_stage
from .further_captures import Separation, separations
from .hypotheses import hypotheses
from .linear_model import LinearModel, smooth_excess
from .model import Model
from .nuisances import fit_lamp_scale
from .pipeline import Validation, compared, polished, rendered_from, solved_light
from .rendering import Progress
from .search import Candidate, Signature, signature
from .selection import (
    HOPELESS,
    MOST_OF_IT,
    SHAPE_FLAW,
    UNKNOWN,
    Bench,
    Place,
    best_singles,
    build_bench,
    exchanged,
    explained_part,
    first_worthy,
    groups,
    left_over,
    merged,
    predictive,
    prior_strain,
    refitted_together,
    remains,
    with_rendered,
    without_idle,
)

__all__ = ["Diagnosis", "Ranked", "Step", "diagnose"]

#: Probability that nothing is missing where no effect was accepted.
NOTHING_MISSING = 0.95

_MOST_EFFECTS = 3
_REFINED = 6

#: The base picture is rendered again when the refit with an effect moves the box's corners further than this; below,
#: it is warped. What moves it by more than a pixel, as half of the light missing does, wants several rounds.
_STALE_PX, _MOST_RENDERINGS = 0.01, 3


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
    """One model on the way. effects : added so far. sigma : standard deviations of their numbers. smooth_excess :
    see linear_model. strain : standard deviations by which camera and lamp miss what is known of them.
    comparison : measured against this model, camera and lamp at their best."""

    effects: tuple[AppliedEffect, ...]
    sigma: tuple[dict[str, float], ...]
    smooth_excess: float
    strain: float
    comparison: Comparison


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a model lacks.

    adequate : whether the model as given is. ranking : every effect tried alone, best first. selected :
    effects in the order added, "unknown" last where something remains. chi2_per_dof, final_chi2_per_dof : of
    the model as given and with the selected effects, nuisances at their best, the base picture's own error
    counted. indistinguishable : groups this capture cannot separate. heldout_pixels, heldout_bands : gain where
    held out from the fit over that where fitted, of the selected effect for which it is least; NaN where it cannot
    be tried. separations : the captures that would separate those groups. model : the given one with the
    selected effects.
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


def diagnose(validation: Validation, progress: Progress | None = None) -> Diagnosis:
    """Find what a validation's residual is made of."""
    report = progress or (lambda part: None)
    if validation.rendered.predictor is None:
        raise InputError("diagnosis", "no compiled variant", "LLVM 16 or newer, or a GPU", variant.HINT)
    prepared, model = validation.prepared, validation.model
    given = model.effects
    bench = build_bench(prepared, validation.rendered, given)
    truncated = after_stage(model.render, given, "settings").max_bounces is not None
    signatures = _signatures(bench, given, truncated, report)
    task, start, residual = bench.task(()), bench.model, bench.model.residual
    candidates = singles = best_singles(task, signatures, residual, _REFINED)
    report(0.75)
    chosen: list[Candidate] = []
    while (best := first_worthy(candidates, residual, task.model, with_rendered(bench, chosen))) is not None:
        bench = _about_better_camera(validation, bench, [*chosen, best])
        chosen = refitted_together(bench, [*chosen, best])
        residual = left_over(bench, chosen)
        hopeless = explained_part(bench.model, residual) < HOPELESS * len(chosen)
        if hopeless and remains(bench.model, residual, with_rendered(bench, chosen)):
            chosen = []
            break
        report(0.75 + 0.2 * len(chosen) / _MOST_EFFECTS)
        if len(chosen) == _MOST_EFFECTS:
            break
        if best.hypothesis.effect.stage == "settings":
            # in the light that was missing other effects look different
            signatures = _signatures(bench, (*given, best.applied), False, lambda part: None)
        taken = {c.hypothesis.effect.id for c in chosen}
        rest = [s for s in signatures if s.hypothesis.effect.id not in taken]
        task = bench.task(chosen)
        candidates = best_singles(task, rest, residual, 3)
    chosen = merged(bench, without_idle(bench, chosen), signatures)
    chosen, known = exchanged(bench, chosen, signatures)
    chosen, known = predictive(bench, chosen, known, signatures)
    residual = left_over(bench, chosen)
    left = remains(bench.model, residual, with_rendered(bench, chosen))
    selected = tuple(c.hypothesis.effect.id for c in chosen)
    if left:
        enough = explained_part(bench.model, residual) > MOST_OF_IT
        selected = (*selected, UNKNOWN) if selected and enough else (UNKNOWN,)
    if selected == (UNKNOWN,):
        chosen, known, residual = [], [], bench.model.residual
    added = tuple(c.applied for c in chosen)
    steps = [
        Step(
            (), (), smooth_excess(start, start.residual), prior_strain(start.residual), validation.comparison
        )
    ]
    for count in range(1, len(chosen) + 1):
        steps.append(
            _step(
                validation, bench, refitted_together(bench, chosen[:count]) if count < len(chosen) else chosen
            )
        )
    report(1.0)
    return Diagnosis(
        adequate=not selected,
        chi2_per_dof=start.chi2 / start.count,
        final_chi2_per_dof=float(residual @ residual) / bench.model.count,
        ranking=_ranking(singles, known, start, left, selected),
        selected=selected,
        indistinguishable=groups(known),
        path=tuple(steps),
        heldout_pixels=_least([p.heldout_pixels for p in known]),
        heldout_bands=_least([p.heldout_bands for p in known]),
        separations=separations(prepared, bench, known),
        model=replace(model, effects=(*model.effects, *added)),
    )


def _least(gains: Sequence[float]) -> float:
    return min((gain for gain in gains if np.isfinite(gain)), default=float("nan"))


def _signatures(
    bench: Bench, given: Sequence[AppliedEffect], truncated: bool, report: Progress
) -> list[Signature]:
    scene = bench.predictor.scene
    bands = bench.predictor.sensing.curves.bands
    known = hypotheses(bands, scene, truncated)
    found, rough = [], bench.predictor.rough()
    for index, hypothesis in enumerate(known):
        one = signature(rough, given, bench.rendered.used, hypothesis)
        if one is not None:
            found.append(one)
        report(0.6 * (index + 1) / len(known))
    return found


def _about_better_camera(validation: Validation, bench: Bench, chosen: Sequence[Candidate]) -> Bench:
    """What the model lacked has pulled at the camera: refit it; render again where it moved or the light changed."""
    prepared, rendered, predictor = validation.prepared, bench.rendered, bench.predictor
    effects = (*bench.given, *(c.applied for c in chosen))
    settings = validation.model.render
    altered = polished(prepared, replace(rendered, signal=predictor.signal(effects)), effects)
    corners = np.concatenate([s.vertices_mm for s in prepared.scene.surfaces])
    resolve = any(c.hypothesis.effect.stage in ("scene", "settings") for c in chosen)
    light = None if resolve else validation.light
    camera = predictor.camera
    for _ in range(_MOST_RENDERINGS):
        moved = altered.fit.camera.project(corners) - camera.project(corners)
        if not resolve and np.sqrt(np.nanmean(moved**2)) <= _STALE_PX:
            break
        light = light or solved_light(prepared, settings, effects)
        camera, resolve = altered.fit.camera, False
        altered = polished(prepared, rendered_from(prepared, light, camera, settings, effects), effects)
    # the signatures are known at the pixels used first
    return build_bench(prepared, replace(altered, used=rendered.used), bench.given)


def _step(validation: Validation, bench: Bench, chosen: Sequence[Candidate]) -> Step:
    """The model with these effects, compared; the lamp's scale is fitted with them in place."""
    prepared, rendered, residual = validation.prepared, bench.rendered, left_over(bench, chosen)
    applied = tuple(c.applied for c in chosen)
    signal = bench.predictor.signal((*bench.given, *applied)) + bench.moved
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, _ = fit_lamp_scale(prepared.measured, signal, variance, rendered.used, prepared.lamp_sigma)
    return Step(
        effects=applied,
        sigma=tuple(dict(c.sigma) for c in chosen),
        smooth_excess=smooth_excess(bench.model, residual),
        strain=prior_strain(residual),
        comparison=compared(prepared, rendered, scale * signal),
    )


def _ranking(
    singles: Sequence[Candidate], known: Sequence[Place], start: LinearModel, left: bool, selected: tuple[str, ...]
) -> tuple[Ranked, ...]:  # fmt: skip
    """The selected effects by what leaving them out costs, then what could stand in their places, then the rest.

    An effect's probability is its share of its place. Where no effect was accepted, that nothing is missing
    takes NOTHING_MISSING of the sum.
    """
    unknown = 0.9 if selected == (UNKNOWN,) else 0.3 if left else 0.02
    entries = {c.hypothesis.effect.id: _ranked(c, start, 0.0) for c in reversed(singles)}
    if set(selected) - {UNKNOWN}:
        for place in sorted(known, key=lambda p: p.empty):
            everyone = [place.candidate, *place.rivals]
            for candidate, share in zip(everyone, _shares(everyone, place.empty), strict=True):
                one = _ranked(candidate, start, (1 - unknown) * share)
                other = entries.get(one.effect)
                if candidate is place.candidate or other is None or one.probability > other.probability:
                    entries[one.effect] = one
    else:
        rest = 1 - unknown if selected else 1 - unknown - NOTHING_MISSING
        for candidate, share in zip(singles, _shares(singles, start.chi2), strict=True):
            entries[candidate.hypothesis.effect.id] = _ranked(candidate, start, rest * share)
    lowest = min((c.chi2 for c in singles), default=start.chi2)
    entries[UNKNOWN] = Ranked(UNKNOWN, {}, {}, lowest / start.count, unknown)
    return tuple(sorted(entries.values(), key=lambda r: (-r.probability, r.chi2_per_dof)))


def _ranked(candidate: Candidate, start: LinearModel, probability: float) -> Ranked:
    values, sigma = dict(candidate.applied.values), dict(candidate.sigma)
    return Ranked(candidate.hypothesis.effect.id, values, sigma, candidate.chi2 / start.count, probability)


def _shares(candidates: Sequence[Candidate], empty: float) -> list[float]:
    """Probabilities from chi2, softened by the error of the effects' shapes."""
    chi2 = np.array([c.chi2 for c in candidates])
    weights = np.exp(-0.5 * (chi2 - chi2.min()) / (1.0 + SHAPE_FLAW * max(empty - chi2.min(), 0.0)))
    return [float(w) for w in weights / weights.sum()]
