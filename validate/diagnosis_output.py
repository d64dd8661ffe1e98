"""A diagnosis as JSON, as a section of the report, and in the terminal."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cboxlab.scenes.files import replacing

from .blocks import Cell, ReportSection, Table, number, significant, with_error
from .console import console, data_table, say
from .diagnosis import Diagnosis, Ranked, Step
from .effects import AppliedEffect, catalogue
from .metrics import PathStep
from .plots import STYLE, diverging_scale, falling_curve, map_row
from .selection import PRIOR_EFFECTS

__all__ = ["diagnosis_record", "diagnosis_sections", "path_steps", "print_diagnosis", "write_diagnosis"]


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """The object that ``cbox diagnose --json`` writes; parameters without a finite value become null."""
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
        "selected_parameters": [
            {k: _finite(v) for k, v in e.values.items()} for e in diagnosis.path[-1].effects
        ],
        "final_chi2_per_dof": diagnosis.final_chi2_per_dof,
        "indistinguishable": [list(group) for group in diagnosis.indistinguishable],
        "heldout_pixels": _finite(diagnosis.heldout_pixels),
        "heldout_bands": _finite(diagnosis.heldout_bands),
        "separations": [asdict(s) for s in diagnosis.separations],
    }


def _finite(value: str | float) -> str | float | None:
    return value if isinstance(value, str) or np.isfinite(value) else None


def write_diagnosis(path: Path, diagnosis: Diagnosis) -> None:
    """Write the record, complete or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(
            json.dumps(diagnosis_record(diagnosis), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )


def path_steps(diagnosis: Diagnosis) -> list[PathStep]:
    """The path for metrics.json."""
    return [
        PathStep(tuple(e.id for e in s.effects), s.comparison.chi2.per_dof, s.comparison.delta_e_ab.mean)
        for s in diagnosis.path
    ]


def _values(effect: AppliedEffect, sigma: dict[str, float]) -> str:
    parts = []
    for name, value in effect.values.items():
        if isinstance(value, str):
            parts.append(value)
        else:
            parts.append(f"{name} {with_error(value, sigma.get(name, np.nan))}")
    return ", ".join(parts)


def _step_name(step: Step) -> str:
    return "+ " + step.effects[-1].id if step.effects else "model as given"


def _in_short(diagnosis: Diagnosis) -> str:
    """The answer in a sentence or two."""
    if diagnosis.adequate:
        return (
            "No effect of the catalogue improves the model by more than the render's own flaws could: "
            "the model is adequate."
        )
    if diagnosis.selected == ("unknown",):
        return (
            "Something is there that noise does not explain, and no effect of the catalogue explains most of it: "
            "unknown."
        )
    last = diagnosis.path[-1]
    effects = zip(last.effects, last.sigma, strict=True)
    found = " and ".join(f"{effect.id} ({_values(effect, sigma)})" for effect, sigma in effects)
    rest = " Something remains that is not in the catalogue." if diagnosis.selected[-1] == "unknown" else ""
    chi2 = last.comparison.chi2.per_dof
    return f"The model lacks {found}; added, it leaves χ² per degree of freedom at {chi2:.3g}.{rest}"


def _in_words(diagnosis: Diagnosis) -> list[str]:
    """The answer in sentences."""
    last = diagnosis.path[-1]
    if diagnosis.adequate:
        return [_in_short(diagnosis)]
    sentences = []
    if diagnosis.selected == ("unknown",):
        sentences.append(_in_short(diagnosis))
    else:
        for effect, sigma in zip(last.effects, last.sigma, strict=True):
            sentences.append(
                f"The model lacks {effect.id}: {_values(effect, sigma)}. To confirm: {effect.effect.confirm}"
            )
        if diagnosis.selected[-1] == "unknown":
            sentences.append("Something remains that none of the catalogue explains; the maps show where.")
    for s in diagnosis.separations:
        further = (
            f"Cheapest way to do so: {s.words} ({s.seconds:.0f} s), which would set them {s.chi2:.0f} apart."
            if s.enough
            else f"None of the further captures considered would do so; the best one, {s.words}, would set them "
            f"{s.chi2:.1f} apart."
        )
        sentences.append(
            f"This capture cannot tell {s.effect} from {s.rival}: {s.now:.1f} apart in χ², 25 are needed. {further}"
        )
    first = diagnosis.path[0].comparison
    c = last.comparison
    sentences.append(
        f"χ² per degree of freedom falls from {first.chi2.per_dof:.3g} to {c.chi2.per_dof:.3g}, mean ΔE*ab from "
        f"{first.delta_e_ab.mean:.2f} to {c.delta_e_ab.mean:.2f} (noise alone {c.delta_e_ab_noise.mean:.2f})."
    )
    if set(diagnosis.selected) & set(PRIOR_EFFECTS):
        sentences.append(
            "The camera and the lamp that fit the picture miss what was surveyed and measured of them by "
            f"{diagnosis.path[0].strain:.1f} standard deviations, with the effects by {last.strain:.1f}; "
            "chance alone makes about 3."
        )
    if np.isfinite(diagnosis.heldout_pixels):
        bands = diagnosis.heldout_bands
        sentences.append(
            f"In pixels held out from the fit the last effect gains {100 * diagnosis.heldout_pixels:.0f} % of what it "
            "gains in the others"
            + (
                f", in bands held out {100 * bands:.0f} % of what it gains fitted to all."
                if np.isfinite(bands)
                else "."
            )
        )
    return sentences


@matplotlib.rc_context(STYLE)
def diagnosis_sections(diagnosis: Diagnosis) -> list[ReportSection]:
    """What is missing, how the error falls, and what else was tried."""
    labels = [_step_name(s) for s in diagnosis.path]
    curve = falling_curve(
        labels,
        [s.comparison.chi2.per_dof for s in diagnosis.path],
        [s.comparison.delta_e_ab.mean for s in diagnosis.path],
    )
    maps = [s.comparison.maps["residual_over_sigma"].mean("band").values for s in diagnosis.path]
    scale = diverging_scale(maps[0], "residual / σ, mean over bands", 0.5)
    effect_rows = [
        (
            r.effect,
            Cell(_ranked_values(r), words=True),
            significant(r.chi2_per_dof, 4),
            number(100 * r.probability, 1),
        )
        for r in diagnosis.ranking[:8]
    ]
    return [
        ReportSection(
            "What the model lacks",
            _in_words(diagnosis),
            [
                curve,
                map_row(dict(zip(labels, maps, strict=True)), scale, "Residuals before and after, one colour scale."),
                Table(("Effect tried alone", "Parameters", "χ²/dof", "Probability, %"), effect_rows,
                      "Camera and lamp refitted with each; the model as given has χ²/dof "
                      f"{diagnosis.chi2_per_dof:.4g}. The base picture's own error is counted here."),
            ],
            finding=_in_short(diagnosis),
        )
    ]  # fmt: skip


def _ranked_values(ranked: Ranked) -> str:
    if ranked.effect not in catalogue():
        return "–"
    return _values(AppliedEffect(catalogue()[ranked.effect], ranked.values), ranked.sigma)


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """The ranking and the path in the terminal."""
    table = data_table("Effects tried alone", "effect", "parameters", "χ²/dof", "probability")
    table.columns[1].no_wrap = False
    for r in diagnosis.ranking[:6]:
        table.add_row(r.effect, _ranked_values(r), f"{r.chi2_per_dof:.4f}", f"{100 * r.probability:.1f} %")
    console.print(table)
    path = data_table("The error falls", "model", "χ²/dof", "ΔE*ab", "noise alone", "camera and lamp off, σ")
    for step in diagnosis.path:
        c = step.comparison
        path.add_row(
            _step_name(step),
            f"{c.chi2.per_dof:.3f}",
            f"{c.delta_e_ab.mean:.3f}",
            f"{c.delta_e_ab_noise.mean:.3f}",
            f"{step.strain:.1f}",
        )
    console.print(path)
    for sentence in _in_words(diagnosis):
        say(sentence)
