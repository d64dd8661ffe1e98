"""One effect of one's own choice fitted to a capture, camera and lamp at their best with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cboxlab.render import variant
from cboxlab.scenes.errors import InputError

from .effects import AppliedEffect, catalogue
from .forward import after_stage
from .hypotheses import hypotheses
from .model import Model
from .pipeline import validate
from .rendering import Progress
from .search import fit, screen, signature
from .selection import build_bench

__all__ = ["fit_effect"]

#: Of the ways in which choices and starting values may be made, so many of the most promising are fitted in full.
_FITTED = 3


def fit_effect(
    capture: Path, model: Model, identifier: str, given: Mapping[str, str | float], progress: Progress | None = None,
    cache: Path | None = None,
) -> tuple[AppliedEffect, float, float]:  # fmt: skip
    """The effect's parameters at the least chi2 in the capture, on top of the model's own effects.

    given : parameters that are not fitted. Returns the effect, with standard deviations of what was fitted, and chi2
    per sample without and with it, camera and lamp at their best either time.

    Raises InputError where the effect cannot act on this capture, or has nothing to fit.
    """
    report = progress or (lambda part: None)
    effect = catalogue()[identifier]
    validation = validate(capture, model, lambda part: report(0.8 * part), cache=cache)
    if validation.rendered.predictor is None:
        raise InputError("--fit", "no compiled variant", "LLVM 16 or newer, or a GPU", variant.HINT)
    bench = build_bench(validation.prepared, validation.rendered, model.effects)
    scene, bands = validation.prepared.scene, bench.predictor.sensing.curves.bands
    truncated = after_stage(model.render, model.effects, "settings").max_bounces is not None
    possible = []
    for hypothesis in hypotheses(bands, scene, truncated):
        kept = {key: value for key, value in given.items() if key in hypothesis.fixed}
        choices = [p.name for p in effect.parameters if p.choices]
        if hypothesis.effect.id != identifier or any(
            hypothesis.fixed[k] != v for k, v in kept.items() if k in choices
        ):
            continue
        numbers = {key: value for key, value in given.items() if key not in choices}
        free = tuple(p for p in hypothesis.free if p.name not in numbers)
        fixed = {**hypothesis.fixed, **numbers}
        possible.append(replace(hypothesis, free=free, fixed=fixed, held=tuple(numbers)))
    task, residual = bench.task(()), bench.model.residual
    known = [signature(bench.predictor, bench.given, bench.rendered.used, h) for h in possible]
    screened = sorted((screen(task, s, residual) for s in known if s is not None), key=lambda c: c.chi2)
    if not screened or not any(h.free for h in possible):
        raise InputError(
            "--fit", f"{identifier}, of which nothing can be fitted here", "an effect with a free number"
        )
    best = min((fit(task, c, residual) for c in screened[:_FITTED]), key=lambda c: c.chi2)
    report(1.0)
    applied = AppliedEffect(effect, best.applied.values, best.sigma)
    return applied, bench.model.chi2 / bench.model.count, best.chi2 / bench.model.count
