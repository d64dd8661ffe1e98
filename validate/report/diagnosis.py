"""A diagnosis as JSON and in sentences."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.utils.files import replacing

from ..compare import HEADLINE
from ..diagnose import Diagnosis, Limit, Ranked, Separation, Step
from .blocks import with_error
from .explanation import explanation_record, explanation_sentence
from .metrics import PathStep

__all__ = [
    "diagnosis_record",
    "error_sentence",
    "evidence_sentences",
    "finding_sentences",
    "further_sentences",
    "in_short",
    "limit_words",
    "path_steps",
    "ranked_values",
    "separation_sentence",
    "step_name",
    "unexplained_sentences",
    "values_words",
    "write_diagnosis",
]


#: So many limits are said; all of them stand in diagnosis.json and the report.
_LIMITS_SHOWN = 3


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """The content of diagnosis.json; parameters without a finite value become null."""
    return {
        "adequate": diagnosis.adequate,
        "chi2_per_dof": diagnosis.chi2_per_dof,
        "ranking": [
            {
                "effect": r.effect,
                "parameters": {k: _finite(v) for k, v in r.values.items()},
                "sigma": {k: _finite(v) for k, v in r.sigma.items()},
                "chi2_per_dof": r.chi2_per_dof,
                "probability": r.probability,
            }
            for r in diagnosis.ranking
        ],
        "selected": list(diagnosis.selected),
        "selected_parameters": [{k: _finite(v) for k, v in e.values.items()} for e in diagnosis.path[-1].effects],
        "final_chi2_per_dof": diagnosis.final_chi2_per_dof,
        "indistinguishable": [list(group) for group in diagnosis.indistinguishable],
        "heldout_pixels": _finite(diagnosis.heldout_pixels),
        "heldout_bands": _finite(diagnosis.heldout_bands),
        "separations": [asdict(s) for s in diagnosis.separations],
        "explanation": explanation_record(diagnosis.explanation),
        "render": None if diagnosis.render is None else asdict(diagnosis.render),
        "further": [asdict(one) for one in diagnosis.further],
        "certainty": _finite(diagnosis.certainty),
        "limits": [asdict(one) for one in diagnosis.limits],
        **({"notes": list(diagnosis.notes)} if diagnosis.notes else {}),
    }


def _finite(value: str | float) -> str | float | None:
    return value if isinstance(value, str) or np.isfinite(value) else None


def write_diagnosis(path: Path, diagnosis: Diagnosis) -> None:
    """Write the record as JSON; an incomplete file is removed."""
    with replacing(path) as temporary:
        temporary.write_text(
            json.dumps(diagnosis_record(diagnosis), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )


def path_steps(diagnosis: Diagnosis) -> list[PathStep]:
    """The path of the diagnosis for metrics.json."""
    return [
        PathStep(tuple(e.id for e in s.effects), s.comparison.chi2.per_dof, s.comparison.colour[HEADLINE.id].mean)
        for s in diagnosis.path
    ]


def _values(effect: AppliedEffect, sigma: Mapping[str, float]) -> str:
    parts = []
    for name, value in effect.values.items():
        if isinstance(value, str):
            parts.append(value)
        else:
            parts.append(f"{name} {with_error(value, sigma.get(name, np.nan))}")
    return ", ".join(parts)


def step_name(step: Step) -> str:
    """Name of a step of the path: the effect it added."""
    return "+ " + step.effects[-1].id if step.effects else "model as given"


def in_short(diagnosis: Diagnosis) -> str:
    """The result in one sentence: the cause and its size, or that the model is adequate, or that nothing known fits."""
    if diagnosis.adequate:
        return "The model is adequate: no effect of the catalogue improves it by more than errors of the render could."
    if diagnosis.selected == ("unknown",):
        return (
            "Nothing known fits (unknown): noise does not explain the difference, and no effect of the catalogue "
            "explains most of it."
        )
    last = diagnosis.path[-1]
    effects = zip(last.effects, last.sigma, strict=True)
    found = " and ".join(f"{effect.id} ({_values(effect, sigma)})" for effect, sigma in effects)
    rest = ", and a difference remains that nothing known explains" if diagnosis.selected[-1] == "unknown" else ""
    return f"The model lacks {found}{rest}."


def separation_sentence(s: Separation) -> str:
    """What tells two effects apart, in standard deviations (the square root of a difference in χ²)."""
    further = (
        f"The fastest further capture that distinguishes them: {s.words} ({s.seconds:.0f} s, expected "
        f"{np.sqrt(max(s.chi2, 0)):.1f})."
        if s.enough
        else f"None of the further captures considered distinguishes them; the best is {s.words} (expected "
        f"{np.sqrt(max(s.chi2, 0)):.1f})."
    )
    return (
        f"This capture cannot distinguish {s.effect} from {s.alternative}: they are {np.sqrt(max(s.now, 0)):.1f} "
        f"standard deviations apart, 5 are needed. {further}"
    )


def error_sentence(diagnosis: Diagnosis) -> str:
    """The error of the model as given, and how it falls where effects were found."""
    first, last = diagnosis.path[0].comparison, diagnosis.path[-1].comparison
    noise = f"(noise alone {last.colour_noise[HEADLINE.id].mean:.2f})"
    if len(diagnosis.path) == 1:
        return (
            f"χ² per degree of freedom is {first.chi2.per_dof:.3g}, mean {HEADLINE.label} "
            f"{first.colour[HEADLINE.id].mean:.2f} {noise}."
        )
    return (
        f"χ² per degree of freedom falls from {first.chi2.per_dof:.4g} to {last.chi2.per_dof:.4g}, "
        f"mean {HEADLINE.label} from {first.colour[HEADLINE.id].mean:.2f} to "
        f"{last.colour[HEADLINE.id].mean:.2f} {noise}."
    )


def unexplained_sentences(diagnosis: Diagnosis) -> list[str]:
    """What no effect explains looks like, where something remains."""
    return [] if diagnosis.explanation is None else [explanation_sentence(diagnosis.explanation)]


def evidence_sentences(diagnosis: Diagnosis) -> list[str]:
    """What the survey and data held out from the fits say of the effects found."""
    last, sentences = diagnosis.path[-1], []
    if any(catalogue()[name].imitates_nuisance for name in diagnosis.selected if name in catalogue()):
        sentences.append(
            "Without effects, the fitted camera and lamp differ from their survey and measurement by "
            f"{diagnosis.path[0].prior_pull:.1f} standard deviations; with the effects, by {last.prior_pull:.1f}; "
            "about 3 is expected by chance."
        )
    if np.isfinite(diagnosis.certainty):
        sentences.append(
            "The difference is small. With the picture's own errors counted, its size is "
            f"{diagnosis.certainty:.1f} times its standard deviation."
        )
    if np.isfinite(diagnosis.heldout_pixels):
        bands = diagnosis.heldout_bands
        sentences.append(
            f"In held-out pixels, the last effect improves χ² by {100 * diagnosis.heldout_pixels:.0f} % of its "
            "improvement in the fitted pixels"
            + (
                f"; in held-out bands, by {100 * bands:.0f} % of its improvement with all bands fitted."
                if np.isfinite(bands)
                else "."
            )
        )
    return sentences


def finding_sentences(diagnosis: Diagnosis) -> list[str]:
    """The result in sentences, the finding first."""
    foreign = [] if diagnosis.render is None else diagnosis.render.sentences
    if diagnosis.adequate:
        further = further_sentences(diagnosis)
        return [in_short(diagnosis), *limit_sentences(diagnosis), *foreign, *further, *diagnosis.notes]
    return [
        in_short(diagnosis),
        *foreign,
        *unexplained_sentences(diagnosis),
        error_sentence(diagnosis),
        *(f"To confirm {effect.id}: {effect.effect.confirm}" for effect in diagnosis.path[-1].effects),
        *further_sentences(diagnosis),
        *(separation_sentence(s) for s in diagnosis.separations),
        *evidence_sentences(diagnosis),
        *diagnosis.notes,
    ]


def limit_sentences(diagnosis: Diagnosis) -> list[str]:
    """What would have been found, of the effects that show most easily."""
    shown = [f"{limit.effect} with {limit_words(limit)}" for limit in diagnosis.limits[:_LIMITS_SHOWN]]
    return [f"Nine times in ten this capture would have shown, among others: {'; '.join(shown)}."] if shown else []


def limit_words(limit: Limit) -> str:
    """Number and size of a limit, and what of. A number that is searched by its inverse square has its value."""
    of = ", ".join(c if isinstance(c, str) else f"{name} {c:g}" for name, c in limit.choices.items())
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    known = next(p for p in catalogue()[limit.effect].numbers if p.name == limit.parameter)
    size = f"off by {limit.distance:.2g}"
    if known.scale != "linear":
        size = f"of {known.from_coordinate(known.null_coordinate + limit.distance):.3g}"
    return f"{limit.parameter} {size}{unit}{f' ({of})' if of else ''}"


def further_sentences(diagnosis: Diagnosis) -> list[str]:
    """What the other captures of the box say, one sentence each, and which of them shows what the first does not."""
    told = [
        f"In {one.capture}, which {'the same' if one.same_camera else 'another'} camera took, χ² per sample is "
        f"{one.chi2_per_dof:.2f} with the model as given and {one.final_chi2_per_dof:.2f} with what was found: "
        f"{'nothing remains' if one.adequate else 'something remains'}."
        for one in diagnosis.further
    ]
    shows = next((one.capture for one in diagnosis.further if not one.adequate), None)
    if shows and not diagnosis.selected:
        told.append(f"{shows} shows what the first capture does not: diagnose it as the first one.")
    return told


def values_words(effect: str, values: Mapping[str, str | float], sigma: Mapping[str, float]) -> str:
    """Parameters of an effect of the catalogue, with their standard deviations."""
    return _values(AppliedEffect(catalogue()[effect], values), sigma)


def ranked_values(ranked: Ranked) -> str:
    """The parameters of an effect tried alone, with their standard deviations."""
    if ranked.effect not in catalogue():
        return "–"
    return values_words(ranked.effect, ranked.values, ranked.sigma)
