"""Chapters of a report on causes: result, missing effects, alternatives, next steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from ..compare import COLOUR_DIFFERENCES, HEADLINE
from ..diagnose import Diagnosis, LikelyCause
from ..diagnose.explain import advice
from .bands import NamedBand
from .blocks import Cell, Headline, ReportSection, ReportTable, Story
from .diagnosis import (
    doubt_sentences,
    error_sentence,
    evidence_sentences,
    explained_share,
    flaw_sentences,
    limit_text,
    ranked_values,
    result_sentence,
    separation_sentence,
    size_in_words,
    step_name,
    unexplained_sentences,
    values_text,
)
from .explanation import explanation_sections
from .numerals import chi2_text, number, significant
from .picture_sections import NOTHING_MISSING, beyond_adequate, pooled
from .plots import STYLE, Drawing, MapRow, falling_curve, map_row, residual_scale
from .verdict import report_verdict

__all__ = ["signature_layers", "story"]

#: Most bands of signatures shown: those that differ most.
_MAX_BANDS = 7

#: Most numbers (pixels times bands) of a picture with layers of signatures in the viewer, to bound the report's size.
_MAX_LAYER_NUMBERS = 1 << 19

#: Largest value of a signature, in standard deviations, below which camera and lamp imitate all of it.
_MIN_VISIBLE_SIGMA = 0.01

#: Sentence on a cause without a signature in the picture.
_IMITATED = " Camera and lamp can imitate all of it: the evidence is their survey and the lamp's stated power alone."

#: Standard deviations between two causes from which they count as distinguished.
_MIN_SEPARATION_SIGMA = 5.0

#: Probabilities below this are 0.0 % in the tables.
_MIN_PROBABILITY = 0.0005

#: Effects in the table of effects tried alone.
_NUM_RANKED = 8


def story(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> Story:
    """Chapters of a diagnosis.

    Parameters
    ----------
    diagnosis
        The diagnosis.
    bands
        Bands in the order of the page, see ``named_bands``.

    Returns
    -------
    Story
        The chapters.
    """
    c = diagnosis.path[0].comparison
    residual = c.maps["residual_over_sigma"].values
    pictures = {"Photograph minus rendering, all bands": pooled(residual)}
    first = next(iter(diagnosis.causes), None)
    if first is not None and diagnosis.selected[0] == first.effect and _visible(first):
        pictures = {
            "Photograph minus rendering": pooled(diagnosis.residual),
            f"Change by {first.effect} alone": pooled(first.signature),
        }
    meaning = [size_in_words(effect) for effect in diagnosis.path[-1].effects]
    details = [
        *meaning,
        *flaw_sentences(diagnosis),
        *doubt_sentences(diagnosis),
        *unexplained_sentences(diagnosis),
        error_sentence(diagnosis),
        *report_verdict(c, bands).details[3:],
        *diagnosis.notes,
    ]
    return Story(
        Headline(
            result_sentence(diagnosis),
            details,
            map_row(pictures, residual_scale("difference / σ, all bands together")),
        ),
        _missing(diagnosis, bands),
        _falling(diagnosis) if len(diagnosis.path) > 1 else None,
        ReportSection("What to do next", steps=_next_steps(diagnosis)),
        explanation_sections(diagnosis.explanation),
    )


def _visible(cause: LikelyCause) -> bool:
    """Whether camera and lamp cannot imitate all of its signature."""
    return bool(np.nanmax(np.abs(cause.signature)) > _MIN_VISIBLE_SIGMA)


def signature_layers(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Layers of the viewer: changes by the likeliest causes, and the difference that remains.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    list
        Layers as ``viewer_data`` takes them; empty for large pictures, to bound the size of the report.
    """
    if diagnosis.residual.size > _MAX_LAYER_NUMBERS:
        return []
    layers: list[dict[str, Any]] = [
        {
            "id": f"cause-{cause.effect}",
            "name": f"{cause.effect} alone, in σ",
            "unit": "σ",
            "perBand": True,
            "values": cause.signature,
        }
        for cause in diagnosis.causes
    ]
    if len(diagnosis.path) > 1:
        remaining = diagnosis.path[-1].comparison.maps["residual_over_sigma"].values.astype(np.float32)
        name = "Difference that remains with the effects found, in σ"
        red = "the photograph is brighter"
        layers.append({"id": "remaining", "name": name, "unit": "σ", "perBand": True, "values": remaining, "red": red})
    return layers


def _limits(diagnosis: Diagnosis) -> ReportTable:
    """Table of the smallest size at which each effect is found."""
    rows = [
        (
            limit.effect,
            Cell(limit_text(limit), wrap=True),
            significant(limit.chi2_per_sample),
            "errors of the rendering" if limit.beside_errors else "size",
        )
        for limit in sorted(diagnosis.limits, key=lambda limit: limit.chi2_per_sample)
    ]
    return ReportTable(
        ("effect", "found nine times in ten from", "χ² per pixel and band", "limited by"),
        rows,
        "The most easily found first: those with the smallest χ². The limits hold to first order for captures like "
        "this one, and for the form of each effect that shows most easily. Errors of the rendering hide small smooth "
        "changes: for these the size is the limit. An effect missing from this table cannot be found, or only by the "
        "survey of camera and lamp.",
    )


def _missing(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> ReportSection:
    """Chapter on the effects that the model lacks, with their alternatives."""
    if diagnosis.adequate:
        return ReportSection(
            "What is missing",
            (NOTHING_MISSING,),
            (*((_limits(diagnosis),) if diagnosis.limits else ()), _ranking(diagnosis)),
        )
    first, *others = diagnosis.causes
    sentences = evidence_sentences(diagnosis)
    if diagnosis.selected[0] == first.effect:
        sentences += [_why_not(first, other, diagnosis) for other in others]
    sentences.append(
        "The rows below show the difference, then the change by each cause alone, for the same bands on one scale. "
        "They leave out changes that camera and lamp can imitate. A cosine of 1 means the same pattern; noise keeps it "
        "below 1."
    )
    return ReportSection("What is missing", sentences, (*_signatures(diagnosis, bands), _ranking(diagnosis)))


def _why_not(first: LikelyCause, other: LikelyCause, diagnosis: Diagnosis) -> str:
    """Comparison of another cause with the first."""
    probability = next((r.probability for r in diagnosis.ranking if r.effect == other.effect), 0.0)
    conclusion = "This capture distinguishes them."
    if probability > _MIN_PROBABILITY:
        conclusion += (
            f" Its probability of {100 * probability:.1f} % is larger than this distance alone would leave, because it "
            "allows for errors of the computed patterns, which noise does not measure."
        )
    if other.behind_sigma <= _MIN_SEPARATION_SIGMA or any(
        {first.effect, other.effect} <= set(group) for group in diagnosis.indistinguishable
    ):
        conclusion = "This capture does not distinguish them; the next steps below name one that does."
    return (
        f"Why not {other.effect} instead of {first.effect}? It fits worse by {other.behind_sigma:.1f} standard "
        f"deviations of the noise. The cosine between the two patterns is {number(other.cosine_with_first)}. "
        f"{conclusion}"
    )


def _signatures(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> list[MapRow]:
    """Maps of the difference and of each cause, for the bands with the largest difference."""
    energy = [float(np.nansum(diagnosis.residual[i].astype(float) ** 2)) for i, _ in bands]
    largest = [bands[i] for i in sorted(np.argsort(energy)[::-1][:_MAX_BANDS])]

    def row(pictures: NDArray, caption: str) -> MapRow:
        return map_row({name: pictures[i] for i, name in largest}, residual_scale(), caption)

    def size(cause: LikelyCause) -> str:
        return _size(diagnosis, cause.effect, values_text(cause.effect, cause.values, cause.sigma))

    return [
        row(diagnosis.residual, "Photograph minus rendering, σ."),
        *(
            row(
                cause.signature,
                f"Change by {cause.effect} alone ({size(cause)}), σ. "
                f"Its cosine with the difference is {number(cause.cosine)}, with the first cause "
                f"{number(cause.cosine_with_first)}." + ("" if _visible(cause) else _IMITATED),
            )
            for cause in diagnosis.causes
        ),
    ]


def _size(diagnosis: Diagnosis, effect: str, alone: str) -> str:
    """Parameters of an effect in the final model, else in the ranking, else fitted alone."""
    last = diagnosis.path[-1]
    in_model = {e.id: values_text(e.id, e.values, sigma) for e, sigma in zip(last.effects, last.sigma, strict=True)}
    in_ranking = {each.effect: ranked_values(each) for each in diagnosis.ranking}
    return in_model.get(effect) or in_ranking.get(effect, alone)


def _before_and_after(diagnosis: Diagnosis) -> ReportTable:
    """Figures of the model as given and with the effects found, in two columns."""
    first, last = (diagnosis.path[k].comparison for k in (0, -1))
    rows = [
        (
            "χ² per degree of freedom",
            chi2_text(first.chi2.per_dof),
            chi2_text(last.chi2.per_dof),
            f"1 ± {significant(last.chi2.per_dof_sigma, 2)}",
        ),
        *(
            (
                f"mean {COLOUR_DIFFERENCES[name].label}",
                number(first.colour[name].mean, 2),
                number(last.colour[name].mean, 2),
                number(last.colour_noise[name].mean, 2),
            )
            for name in first.colour
        ),
        (
            "rms luminance difference, %",
            number(100 * first.luminance.rms, 2),
            number(100 * last.luminance.rms, 2),
            number(100 * last.luminance.rms_noise, 2),
        ),
        (
            "rendering noise / sensor noise",
            number(first.render_sigma_over_sensor_sigma, 2),
            number(last.render_sigma_over_sensor_sigma, 2),
            "–",
        ),
    ]
    caption = (
        "Noise alone is that of the model with the effects found. It is taken as independent between bands. The "
        "rendering's noise is alike in all bands and shifts colours less, so that a colour difference may lie a little "
        "below noise alone. A rendering with less noise makes a difference count more."
    )
    return ReportTable(("figure", "model as given", "with the effects found", "noise alone"), rows, caption)


def _ranking(diagnosis: Diagnosis) -> ReportTable:
    """Effects tried alone, by the part of the excess that each explains."""
    rows = [
        (
            r.effect,
            Cell(_size(diagnosis, r.effect, ranked_values(r)), wrap=True),
            number(100 * explained_share(diagnosis, r), 1),
            number(100 * r.probability, 1),
        )
        for r in diagnosis.ranking[:_NUM_RANKED]
    ]
    caption = (
        "Camera and lamp are refitted with each effect. The parameters of an effect found are of the final model. "
        "Errors of the rendering count as noise here, so that none of them is taken for an effect; the true effect may "
        "explain a little more than 100 %. "
    )
    if diagnosis.adequate:
        caption += "What the probabilities lack to 100 % is the probability that the model lacks nothing. "
    else:
        caption += (
            "The probability of an effect found is that it is the cause, and not one of its alternatives. Each of "
            "several effects has its probability. "
        )
    caption += "The probability of 'unknown' is that the cause is not in the catalogue."
    return ReportTable(
        ("effect tried alone", "parameters", "explains of the excess, %", "probability, %"), rows, caption
    )


@matplotlib.rc_context(STYLE)
def _falling(diagnosis: Diagnosis) -> ReportSection:
    """Chapter on the error after each added effect."""
    labels = [step_name(s) for s in diagnosis.path]
    curve: Drawing = falling_curve(
        labels,
        [s.comparison.chi2.per_dof for s in diagnosis.path],
        [s.comparison.colour[HEADLINE.id].mean for s in diagnosis.path],
        HEADLINE.label,
    )
    maps = [pooled(s.comparison.maps["residual_over_sigma"].values) for s in diagnosis.path]
    scale = residual_scale("difference / σ, all bands together")
    return ReportSection(
        "The error falling",
        (),
        (
            _before_and_after(diagnosis),
            curve,
            map_row(dict(zip(labels, maps, strict=True)), scale, "Photograph minus rendering at each step."),
        ),
    )


def _next_steps(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Steps for the reader: confirm, add to the model, take a further capture, search the rest."""
    if diagnosis.adequate:
        return beyond_adequate()
    steps = []
    for effect in diagnosis.path[-1].effects:
        values = " ".join(f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in effect.values.items())
        steps.append(f"Confirm {effect.id} in the laboratory. {effect.effect.confirm}")
        steps.append(f"Add it to the model: {effect.id} {values}. The file model.toml next to this report has it.")
    steps += [separation_sentence(s) for s in diagnosis.separations]
    if diagnosis.explanation is not None:
        steps.append(advice(diagnosis.explanation).experiment)
    if diagnosis.path[-1].effects and not diagnosis.separations:
        first = diagnosis.causes[0].effect
        steps += [
            f"You need no further capture to distinguish {first} from {other.effect}: this capture does, by "
            f"{other.behind_sigma:.1f} standard deviations of the noise."
            for other in diagnosis.causes[1:2]
            if other.behind_sigma > _MIN_SEPARATION_SIGMA
        ]
    return tuple(steps)
