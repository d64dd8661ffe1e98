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
from cboxlab.utils.numbers import json_value

from ..compare import HEADLINE
from ..diagnose import Diagnosis, Limit, Ranked, Separation, Step, Verdict
from ..diagnose.explain import advice
from .explanation import explanation_record, explanation_sentence, laboratory_sentences
from .metrics import PathStep
from .numerals import chi2_text, with_error

__all__ = [
    "diagnosis_record",
    "doubt_sentences",
    "error_sentence",
    "evidence_sentences",
    "explained_share",
    "finding_sentences",
    "flaw_sentences",
    "further_sentences",
    "limit_text",
    "path_steps",
    "ranked_values",
    "result_sentence",
    "separation_sentence",
    "size_in_words",
    "step_name",
    "unexplained_sentences",
    "values_text",
    "write_diagnosis",
]


#: Factor on the detectable size from which it is worth a sentence.
_MIN_COST = 1.1

#: Excess of chi-square per degree of freedom from which its parts are given.
_MIN_EXCESS = 0.01

#: Descriptions of the kinds of flaws of a base.
_FLAWS = {
    "creases": "Corners that are softer or darker than in the model",
    "edges": "Edges of walls and blocks that lean or differ in size",
    "shading": "Faces that are lit or painted unevenly",
    "slopes": "Walls that lean or bulge, and so receive more or less light,",
    "paints": "Paints that differ from their tables by about a spectrophotometer's error",
    "lens": "Corners of the picture that the lens blurs, as by a curved field,",
    "field": "Slow changes over the picture, alike in all bands,",
    "pixels": "Single pixels, alike in all bands, as with old flats or a photograph simulated from a noisy rendering,",
}

#: Limits of detection in the sentence of the terminal; diagnosis.json and the report have all of them.
_NUM_LIMITS = 3


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """Content of diagnosis.json.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    dict
        Plain values; parameters without a finite value are None.
    """
    return {
        "adequate": diagnosis.adequate,
        "chi2_per_dof": diagnosis.chi2_per_dof,
        "ranking": [
            {
                "effect": r.effect,
                "parameters": json_value(r.values),
                "sigma": json_value(r.sigma),
                "chi2_per_dof": r.chi2_per_dof,
                "probability": r.probability,
            }
            for r in diagnosis.ranking
        ],
        "selected": list(diagnosis.selected),
        "selected_parameters": [json_value(e.values) for e in diagnosis.path[-1].effects],
        "final_chi2_per_dof": diagnosis.final_chi2_per_dof,
        "indistinguishable": [list(group) for group in diagnosis.indistinguishable],
        "heldout_pixels": json_value(diagnosis.heldout_pixels),
        "heldout_bands": json_value(diagnosis.heldout_bands),
        "separations": [asdict(s) for s in diagnosis.separations],
        "explanation": explanation_record(diagnosis.explanation),
        "render": None if diagnosis.render is None else asdict(diagnosis.render),
        "further": [asdict(result) for result in diagnosis.further],
        "certainty": json_value(diagnosis.certainty),
        "limits": [asdict(limit) for limit in diagnosis.limits],
        "doubts": _doubts_record(diagnosis),
        **({"notes": list(diagnosis.notes)} if diagnosis.notes else {}),
        **({"base_flaws": [asdict(flaw) for flaw in diagnosis.flaws]} if diagnosis.flaws else {}),
        **({"flaws_cost": diagnosis.flaws_cost} if diagnosis.flaws else {}),
        **(
            {"beside_flaws": [json_value(asdict(verdict)) for verdict in diagnosis.verdicts]} if diagnosis.flaws else {}
        ),
    }


def _doubts_record(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Forms of unlisted causes by effect; lead is 2 ln of the odds of the form over the effect."""
    return [
        {"effect": effect, "family": lead.title, "form": lead.form, "lead": lead.lead}
        for effect, lead in diagnosis.doubts.items()
    ]


def write_diagnosis(path: Path, diagnosis: Diagnosis) -> None:
    """Write diagnosis.json; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    diagnosis
        The diagnosis.
    """
    with replacing(path) as temporary:
        temporary.write_text(
            json.dumps(diagnosis_record(diagnosis), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )


def path_steps(diagnosis: Diagnosis) -> list[PathStep]:
    """Models tried by a diagnosis, for metrics.json.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        One entry per model, the given one first.
    """
    return [
        PathStep(tuple(e.id for e in s.effects), s.comparison.chi2.per_dof, s.comparison.colour[HEADLINE.id].mean)
        for s in diagnosis.path
    ]


def _parameter_text(effect: AppliedEffect, sigma: Mapping[str, float]) -> str:
    """Values of an effect with standard deviations and units."""
    parameters = {each.name: each for each in effect.effect.parameters}
    parts = []
    for name, value in effect.values.items():
        if isinstance(value, str):
            parts.append(value)
            continue
        parameter = parameters[name]
        size = with_error(value, sigma.get(name, np.nan))
        parts.append(f"{parameter.label} {size} {parameter.printed_unit}".rstrip())
    return ", ".join(parts)


def step_name(step: Step) -> str:
    """Name of a step of the path.

    Parameters
    ----------
    step
        The step.

    Returns
    -------
    str
        The effect that it added, after a plus sign; "model as given" for the first.
    """
    return "+ " + step.effects[-1].id if step.effects else "model as given"


def result_sentence(diagnosis: Diagnosis) -> str:
    """Result of a diagnosis in one sentence.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    str
        The cause and its size, or that the model is adequate, or that no effect of the catalogue fits.
    """
    if diagnosis.adequate:
        return "The model is adequate: no effect of the catalogue improves it more than errors of the rendering could."
    if diagnosis.selected == ("unknown",):
        return (
            "No known effect fits (unknown). Noise does not explain the difference, and no effect of the catalogue "
            "explains most of it."
        )
    last = diagnosis.path[-1]
    effects = zip(last.effects, last.sigma, strict=True)
    causes = " and ".join(f"{effect.id} ({_parameter_text(effect, sigma)})" for effect, sigma in effects)
    rest = ", and no known effect explains the rest" if diagnosis.selected[-1] == "unknown" else ""
    return f"The model lacks {causes}{rest}."


def flaw_sentences(diagnosis: Diagnosis) -> list[str]:
    """Flaws of the base itself, what they cost, and effects that do not hold next to them.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        Sentences; empty where the base shows no flaw.
    """
    if not diagnosis.flaws:
        return []
    sentences = ["Small flaws of the scene, the survey or the flats explain part of the difference."]
    sentences += [f"{_FLAWS[flaw.kind]} explain {flaw.chi2_per_dof:.2f} of χ² per sample." for flaw in diagnosis.flaws]
    if diagnosis.flaws_cost >= _MIN_COST:
        sentences.append(
            f"Because of these flaws, an effect must be {diagnosis.flaws_cost:.1f} times as large to be detected."
        )
    refused = (verdict for verdict in diagnosis.verdicts if not verdict.holds and verdict.gain > 0)
    refused = (verdict for verdict in refused if verdict.effect not in diagnosis.doubts)
    imitable = next((flaw.kind for flaw in diagnosis.flaws if not flaw.of_single_pixels), "")
    return [*sentences, *(_reason_of_refusal(verdict, imitable) for verdict in refused)]


def doubt_sentences(diagnosis: Diagnosis) -> list[str]:
    """Causes outside the catalogue that explain as much as an effect.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        Sentences; empty where every selected effect is distinguished from such causes.
    """
    sentences = []
    for effect, lead in diagnosis.doubts.items():
        cause = f"{lead.title} ({lead.form})"
        if effect in diagnosis.selected:
            sentences.append(f"This capture cannot distinguish {effect} from {cause}, which is not in the catalogue.")
        else:
            sentences.append(f"{effect} is not reported: {cause} explains the same difference as well or better.")
        if lead.advice is not None:
            sentences.append(f"To distinguish them: {lead.advice.experiment}")
    return list(dict.fromkeys(sentences))


def _reason_of_refusal(verdict: Verdict, largest_flaw: str) -> str:
    """Reason for which an effect that fits is not reported.

    largest_flaw : kind of the largest flaw that effects may imitate.
    """
    if verdict.holds_next_to_flaws:
        return (
            f"{verdict.effect} is not reported: pixels or bands that the fit left out do not confirm it, or its size "
            "is within the tolerance of the survey."
        )
    if verdict.certainty <= 0:
        return f"{verdict.effect} is not reported: with the flaws in the fit, nothing remains of it."
    if not verdict.needed and largest_flaw == "paints":
        return (
            f"{verdict.effect} is not reported: this capture cannot distinguish it from paints within their tolerance. "
            f"To distinguish them: {catalogue()[verdict.effect].confirm}"
        )
    if not verdict.needed:
        return f"{verdict.effect} is not reported: the flaws explain the difference about as well without it."
    return (
        f"{verdict.effect} is not reported: the flaws may imitate it. With the flaws in the fit, its size is "
        f"{100 * verdict.stability:.0f} % of the size without them ({verdict.certainty:.1f} standard deviations)."
    )


def separation_sentence(s: Separation) -> str:
    """Sentences on two effects that a capture cannot distinguish, and on the capture that would.

    Distances are in standard deviations, the square root of a difference in χ².

    Parameters
    ----------
    s
        The two effects, and the best further capture.

    Returns
    -------
    str
        Two or three sentences.
    """
    further = (
        f"The fastest further capture that distinguishes them is {s.description} ({s.seconds:.0f} s; "
        f"{np.sqrt(max(s.chi2, 0)):.1f} standard deviations expected)."
        if s.enough
        else f"No further capture of those considered distinguishes them; the best is {s.description} "
        f"({np.sqrt(max(s.chi2, 0)):.1f} standard deviations expected)."
    )
    apart = np.sqrt(max(s.now, 0))
    needed = "and 5 are needed" if apart < 5 else "but what no effect explains may be as large"
    return (
        f"This capture cannot distinguish {s.effect} from {s.alternative}: they differ by {apart:.1f} standard "
        f"deviations of the noise, {needed}. {further}"
    )


def error_sentence(diagnosis: Diagnosis) -> str:
    """Error of the model as given, and with the effects found.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    str
        Reduced χ² and mean colour difference, next to its expectation from noise.
    """
    first, last = diagnosis.path[0].comparison, diagnosis.path[-1].comparison
    noise = f"(noise alone {last.colour_noise[HEADLINE.id].mean:.2f})"
    if len(diagnosis.path) == 1:
        return (
            f"χ² per degree of freedom is {chi2_text(first.chi2.per_dof)}, mean {HEADLINE.label} "
            f"{first.colour[HEADLINE.id].mean:.2f} {noise}."
        )
    return (
        f"χ² per degree of freedom falls from {chi2_text(first.chi2.per_dof)} to {chi2_text(last.chi2.per_dof)}, "
        f"mean {HEADLINE.label} from {first.colour[HEADLINE.id].mean:.2f} to "
        f"{last.colour[HEADLINE.id].mean:.2f} {noise}."
    )


def unexplained_sentences(diagnosis: Diagnosis) -> list[str]:
    """Description of the difference that no effect explains.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        One text; empty where nothing remains.
    """
    return [] if diagnosis.explanation is None else [explanation_sentence(diagnosis.explanation)]


def _laboratory_lines(diagnosis: Diagnosis) -> list[str]:
    """Place, causes and experiment of what remains; empty where nothing does."""
    if diagnosis.explanation is None:
        return []
    experiment = advice(diagnosis.explanation).experiment
    return [*laboratory_sentences(diagnosis.explanation), f"To settle it: {experiment}"]


def evidence_sentences(diagnosis: Diagnosis) -> list[str]:
    """Evidence for the effects found, from the survey and from data held out of the fits.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        Sentences; empty without such evidence.
    """
    last, sentences = diagnosis.path[-1], []
    if any(catalogue()[name].imitates_nuisance for name in diagnosis.selected if name in catalogue()):
        sentences.append(
            "Without effects, the fitted camera and lamp differ from their survey and measurement by "
            f"{diagnosis.path[0].prior_pull:.1f} standard deviations; with the effects, by {last.prior_pull:.1f}. "
            "Chance alone gives about 3."
        )
    if np.isfinite(diagnosis.certainty):
        sentences.append(
            "The difference is small. Its size is "
            f"{diagnosis.certainty:.1f} times its standard deviation, which includes errors of the rendering."
        )
    names = [name for name in diagnosis.selected if name != "unknown"]
    effect, at_least = ("each effect", "at least ") if len(names) > 1 else ("".join(names), "")
    if np.isfinite(diagnosis.heldout_pixels):
        sentences.append(
            f"Fitted in one half of the pixels, {effect} lowers χ² in the other half by {at_least}"
            f"{100 * diagnosis.heldout_pixels:.0f} % of the decrease in the first half."
        )
        if np.isfinite(diagnosis.heldout_bands):
            sentences.append(
                f"Fitted in all bands but one, {effect} lowers χ² in that band by {at_least}"
                f"{100 * diagnosis.heldout_bands:.0f} % of the decrease with all bands fitted."
            )
    return sentences


def finding_sentences(diagnosis: Diagnosis) -> list[str]:
    """Result of a diagnosis in sentences for the terminal, the finding first.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        Finding, size of the error, confirmation, further captures and evidence.
    """
    external = [] if diagnosis.render is None else diagnosis.render.sentences
    if diagnosis.adequate:
        further = further_sentences(diagnosis)
        flaws = flaw_sentences(diagnosis)
        return [result_sentence(diagnosis), *flaws, *limit_sentences(diagnosis), *external, *further, *diagnosis.notes]
    return [
        result_sentence(diagnosis),
        *external,
        *flaw_sentences(diagnosis),
        *doubt_sentences(diagnosis),
        *unexplained_sentences(diagnosis),
        error_sentence(diagnosis),
        *_laboratory_lines(diagnosis),
        *(f"To confirm {effect.id}: {effect.effect.confirm}" for effect in diagnosis.path[-1].effects),
        *further_sentences(diagnosis),
        *(separation_sentence(s) for s in diagnosis.separations),
        *evidence_sentences(diagnosis),
        *diagnosis.notes,
    ]


def limit_sentences(diagnosis: Diagnosis) -> list[str]:
    """Limits of detection of the effects that show most easily.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        One sentence; empty without limits.
    """
    limits = [f"{limit.effect} with {limit_text(limit)}" for limit in diagnosis.limits[:_NUM_LIMITS]]
    return [f"Nine of ten such captures show these effects, among others: {'; '.join(limits)}."] if limits else []


def limit_text(limit: Limit) -> str:
    """Parameter and size of a limit of detection.

    Parameters
    ----------
    limit
        The limit.

    Returns
    -------
    str
        The parameter with its distance from the value without effect; with its value, if it is not searched on a
        linear scale. The choices of the effect follow in brackets.
    """
    by_name = {p.name: p for p in catalogue()[limit.effect].parameters}
    parameter = by_name[limit.parameter]
    of = ", ".join(
        choice if isinstance(choice, str) else f"{by_name[name].label} {choice:g} {by_name[name].printed_unit}".rstrip()
        for name, choice in limit.choices.items()
    )
    size = f"off by {limit.distance:.2g}"
    if parameter.scale != "linear":
        size = f"of {parameter.from_coordinate(parameter.null_coordinate + limit.distance):.3g}"
    size = f"{parameter.label} {size} {parameter.printed_unit}".rstrip()
    return f"{size} ({of})" if of else size


def further_sentences(diagnosis: Diagnosis) -> list[str]:
    """Results of the further captures of the box.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        One sentence per capture, and advice where one of them shows more than the first.
    """
    sentences = [
        f"In {result.capture}, taken with {'the same' if result.same_camera else 'another'} camera, χ² per sample is "
        f"{result.chi2_per_dof:.2f} with the model as given and {result.final_chi2_per_dof:.2f} with the effects "
        f"found: {'nothing remains' if result.adequate else 'a difference remains'}."
        for result in diagnosis.further
    ]
    revealing = next((result.capture for result in diagnosis.further if not result.adequate), None)
    if revealing and not diagnosis.selected:
        sentences.append(
            f"{revealing} shows a difference that the first capture does not: diagnose it as the first one."
        )
    return sentences


def values_text(effect: str, values: Mapping[str, str | float], sigma: Mapping[str, float]) -> str:
    """Parameters of an effect of the catalogue as text.

    Parameters
    ----------
    effect
        Identifier of the effect.
    values
        Values of its parameters.
    sigma
        Standard deviations of the numbers among them.

    Returns
    -------
    str
        Values with their standard deviations.
    """
    return _parameter_text(AppliedEffect(catalogue()[effect], values), sigma)


def size_in_words(effect: AppliedEffect) -> str:
    """Size of an effect in plain words.

    Parameters
    ----------
    effect
        The effect with its parameters.

    Returns
    -------
    str
        A sentence; the effect's title where no size can be said so.
    """
    if not effect.effect.in_words:
        return f"{effect.id}: {effect.effect.short_title}."
    values = {k: v if isinstance(v, str) else _Signed(v) for k, v in effect.values.items()}
    return f"{effect.id}: {effect.effect.in_words.format(**values)}."


class _Signed(float):
    """Number whose text has a minus sign, and a space before the percent sign."""

    def __format__(self, form: str) -> str:
        return format(float(self), form).replace("-", "−").replace("%", " %")


def explained_share(diagnosis: Diagnosis, ranked: Ranked) -> float:
    """Part of the excess that an effect tried alone explains.

    Parameters
    ----------
    diagnosis
        The diagnosis.
    ranked
        Entry of its ranking.

    Returns
    -------
    float
        May exceed 1, since errors of the rendering count as noise; NaN without an excess.
    """
    excess = diagnosis.chi2_per_dof - 1
    return (diagnosis.chi2_per_dof - ranked.chi2_per_dof) / excess if excess > _MIN_EXCESS else float("nan")


def ranked_values(ranked: Ranked) -> str:
    """Parameters of an effect tried alone.

    Parameters
    ----------
    ranked
        Entry of the ranking.

    Returns
    -------
    str
        Values with their standard deviations; a dash for an unknown cause.
    """
    if ranked.effect not in catalogue():
        return "–"
    return values_text(ranked.effect, ranked.values, ranked.sigma)
