"""What a report tells of causes: the first sentence, what is missing, why not another, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from cboxlab.rendering.effects import catalogue
from numpy.typing import NDArray

from ..compare import HEADLINE, Comparison
from ..diagnose import Cause, Diagnosis
from .bands import NamedBand
from .blocks import Cell, Headline, ReportSection, Story, Table, number, significant
from .diagnosis import (
    error_sentence,
    evidence_sentences,
    in_short,
    limit_words,
    ranked_values,
    separation_sentence,
    step_name,
    unexplained_sentences,
    values_words,
)
from .explanation import explanation_sections
from .plots import STYLE, Drawing, MapRow, falling_curve, map_row, residual_scale
from .verdict import verdict

__all__ = ["pooled", "signature_layers", "story", "story_without"]

#: So many bands of signatures are shown: those that differ most.
_MOST_BANDS = 7

#: Pictures of more numbers (pixels times bands) have no layers of signatures in the viewer.
_MOST_LAYERED = 1 << 19

#: A signature that is nowhere larger than so many standard deviations is not in the picture.
_SEEN = 0.01

_IMITATED = " Camera and lamp can imitate all of it: only the survey and the lamp's stated power speak of it."

#: Standard deviations between two causes that count as told apart.
_TOLD_APART = 5.0

#: Probabilities below this are 0.0 % in the tables.
_LEAST_STATED = 0.0005


def pooled(values: NDArray) -> NDArray[np.float64]:
    """(y, x) the sum of (band, y, x) over the bands used, over its standard deviation; NaN with none."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.sqrt(count), np.nan)


def story_without(c: Comparison, bands: Sequence[NamedBand]) -> Story:
    """The story of a comparison whose cause was not sought."""
    found = verdict(c, bands)
    residual = pooled(c.maps["residual_over_sigma"].values)
    picture = map_row({"Measured − rendered, all bands": residual}, residual_scale())
    adequate = found.level == "explained"
    sentence = (
        "The model is adequate: noise explains the difference."
        if adequate
        else f"{found.headline} Its cause was not sought."
    )
    seek = "A diagnosis of this capture tries every effect of the catalogue and names what the model lacks."
    return Story(
        Headline(sentence, found.details, picture),
        ReportSection(
            "What is missing",
            ("Nothing that this capture could show." if adequate else "Its cause was not sought.",),
        ),
        None,
        ReportSection("What to do next", steps=_beyond_adequate() if adequate else (seek,)),
    )


def _beyond_adequate() -> tuple[str, ...]:
    return (
        "Nothing has to be added to the model.",
        "More frames per band lower the noise: what it hides now may then show.",
    )


def story(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> Story:
    """The story of a diagnosis. bands : see ``named_bands``."""
    c = diagnosis.path[0].comparison
    residual = c.maps["residual_over_sigma"].values
    pictures = {"Measured − rendered, all bands": pooled(residual)}
    first = next(iter(diagnosis.causes), None)
    if first is not None and diagnosis.selected[0] == first.effect and _visible(first):
        pictures = {
            "What the photograph shows": pooled(diagnosis.residual),
            f"What {first.effect} would show": pooled(first.signature),
        }
    meaning = [f"{e.id}: {e.effect.short_title}." for e in diagnosis.path[-1].effects]
    details = [
        *meaning,
        *unexplained_sentences(diagnosis),
        error_sentence(diagnosis),
        *verdict(c, bands).details[3:],
        *diagnosis.notes,
    ]
    return Story(
        Headline(
            in_short(diagnosis),
            details,
            map_row(pictures, residual_scale("difference / σ, all bands together")),
        ),
        _missing(diagnosis, bands),
        _falling(diagnosis) if len(diagnosis.path) > 1 else None,
        ReportSection("What to do next", steps=_next_steps(diagnosis)),
        explanation_sections(diagnosis.explanation),
    )


def _visible(cause: Cause) -> bool:
    """Whether it shows in the picture otherwise than camera and lamp can imitate."""
    return bool(np.nanmax(np.abs(cause.signature)) > _SEEN)


def signature_layers(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Layers of the viewer: what the likeliest causes would show, and what remains with all effects found.

    None for large pictures, with which the report would grow beyond its limit.
    """
    if diagnosis.residual.size > _MOST_LAYERED:
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
        left = diagnosis.path[-1].comparison.maps["residual_over_sigma"].values.astype(np.float32)
        name = "What remains with the effects found, in σ"
        layers.append({"id": "remaining", "name": name, "unit": "σ", "perBand": True, "values": left})
    return layers


def _limits(diagnosis: Diagnosis) -> Table:
    """The smallest size at which each effect would have been found."""
    rows = [
        (
            limit.effect,
            Cell(limit_words(limit), words=True),
            significant(limit.chi2_per_sample),
            "the picture's errors" if limit.beside_errors else "size",
        )
        for limit in diagnosis.limits
    ]
    return Table(
        ("effect", "found nine times in ten with", "χ² per pixel and band", "limited by"),
        rows,
        "In captures like this one, to first order, in the way in which the effect shows most easily. Small smooth "
        "changes are not told from errors of the picture: there the size is the limit. An effect that "
        "does not stand here would be found at no size, or only by what is known of camera and lamp.",
    )


def _missing(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> ReportSection:
    if diagnosis.adequate:
        return ReportSection(
            "What is missing",
            ("Nothing that this capture could show.",),
            (*((_limits(diagnosis),) if diagnosis.limits else ()), _ranking(diagnosis)),
        )
    first, *others = diagnosis.causes
    words = evidence_sentences(diagnosis)
    if diagnosis.selected[0] == first.effect:
        words += [_why_not(first, other, diagnosis) for other in others]
    words.append(
        "Below, the difference and what each cause alone would make of it: the same bands, the same scale, without "
        "what a change of camera and lamp can imitate. A cosine of 1 means the same pattern; noise keeps it below 1."
    )
    return ReportSection("What is missing", words, (*_signatures(diagnosis, bands), _ranking(diagnosis)))


def _why_not(first: Cause, other: Cause, diagnosis: Diagnosis) -> str:
    stated = next((r.probability for r in diagnosis.ranking if r.effect == other.effect), 0.0)
    told = "This capture tells them apart."
    if stated > _LEAST_STATED:
        told += f" Its probability of {100 * stated:.1f} % counts the errors of the computed patterns, too."
    if other.behind_sigma <= _TOLD_APART or any(
        {first.effect, other.effect} <= set(group) for group in diagnosis.indistinguishable
    ):
        told = "This capture does not tell them apart; what would is said below."
    return (
        f"Why not {other.effect} in place of {first.effect}? It fits worse by {other.behind_sigma:.1f} standard "
        f"deviations of the noise; the cosine between the two patterns is {number(other.cosine_with_first)}. {told}"
    )


def _signatures(diagnosis: Diagnosis, bands: Sequence[NamedBand]) -> list[MapRow]:
    energy = [float(np.nansum(diagnosis.residual[i].astype(float) ** 2)) for i, _ in bands]
    chosen = sorted(np.argsort(energy)[::-1][:_MOST_BANDS])
    shown = [bands[i] for i in chosen]

    def row(pictures: NDArray, caption: str) -> MapRow:
        return map_row({name: pictures[i] for i, name in shown}, residual_scale(), caption)

    return [
        row(diagnosis.residual, "The difference: measured − rendered, σ."),
        *(
            row(
                cause.signature,
                f"{cause.effect} ({values_words(cause.effect, cause.values, cause.sigma)}): cosine with the difference "
                f"{number(cause.cosine)}, with the first cause {number(cause.cosine_with_first)}."
                + ("" if _visible(cause) else _IMITATED),
            )
            for cause in diagnosis.causes
        ),
    ]


def _ranking(diagnosis: Diagnosis) -> Table:
    """Effects tried alone, by the part of the excess that each explains."""
    excess = diagnosis.chi2_per_dof - 1
    rows = [
        (
            r.effect,
            Cell(ranked_values(r), words=True),
            number(100 * (diagnosis.chi2_per_dof - r.chi2_per_dof) / excess if excess > 0.01 else np.nan, 1),
            number(100 * r.probability, 1),
        )
        for r in diagnosis.ranking[:8]
    ]
    return Table(
        ("effect tried alone", "parameters", "explains of the excess, %", "probability, %"),
        rows,
        "Camera and lamp are refitted with each effect. The errors that the render itself may have count as noise "
        "here, so that they do not pass for an effect; a right effect may explain a little more than 100 %. "
        "Probability: of an effect found, that it is the cause and not one of those that could stand in its stead; "
        "several effects found together have theirs each. Of unknown: that a cause not in the catalogue is at work.",
    )


@matplotlib.rc_context(STYLE)
def _falling(diagnosis: Diagnosis) -> ReportSection:
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
        (curve, map_row(dict(zip(labels, maps, strict=True)), scale, "What remains at each step.")),
    )


def _next_steps(diagnosis: Diagnosis) -> tuple[str, ...]:
    if diagnosis.adequate:
        return _beyond_adequate()
    steps = []
    for effect in diagnosis.path[-1].effects:
        values = " ".join(f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in effect.values.items())
        steps.append(f"Confirm {effect.id} in the laboratory. {effect.effect.confirm}")
        steps.append(f"Add it to the model: {effect.id} {values}; model.toml beside this report has it.")
    steps += [separation_sentence(s) for s in diagnosis.separations]
    if diagnosis.selected[-1] not in catalogue():
        steps.append(
            "Look at what remains in the viewer above, difference in σ, band by band. A pattern that follows a "
            "surface, a band or the order of the exposures says where to search; you can add an effect of your own."
        )
    if diagnosis.path[-1].effects and not diagnosis.separations:
        first = diagnosis.causes[0].effect
        steps += [
            f"No further capture is needed to tell {first} from {other.effect}: this one does, by "
            f"{other.behind_sigma:.0f} standard deviations of the noise."
            for other in diagnosis.causes[1:2]
            if other.behind_sigma > _TOLD_APART
        ]
    return tuple(steps)
