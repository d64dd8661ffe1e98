"""Explanation of the difference that no effect explains: record, text, pictures."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import field_record

from ..diagnose.explain import NONE, SOUND, Explanation, advice, appearance, motions
from ..diagnose.families import families
from .blocks import Cell, ReportSection, ReportTable
from .numerals import number, significant
from .plots import map_row, residual_scale

__all__ = ["explanation_record", "explanation_sections", "explanation_sentence", "laboratory_sentences"]

#: Most bands shown as maps: those with the strongest change.
_MAX_MAPS = 4

#: Most causes that are listed where none is likelier than not.
_MAX_LIKELY = 3

#: Smallest probability of a cause that is listed: rarer ones are no help in the laboratory.
_MIN_LIKELY = 0.1


def explanation_record(explanation: Explanation | None) -> dict[str, Any]:
    """Entry of diagnosis.json.

    Parameters
    ----------
    explanation
        The explanation; None where nothing remains.

    Returns
    -------
    dict
        Plain values; the family is ``none`` where nothing remains.
    """
    if explanation is None:
        return {
            "family": NONE,
            "surface": None,
            "centre_px": None,
            "bands": [],
            "share": 0.0,
            "runner_up": None,
            "field": None,
        }
    guidance = advice(explanation)
    centre = explanation.centre_px
    return {
        "family": explanation.family,
        "surface": explanation.surface,
        "centre_px": None if centre is None else [round(float(c), 2) for c in centre],
        "bands": list(explanation.bands),
        "share": float(explanation.share),
        "runner_up": explanation.runner_up,
        "told_apart": bool(explanation.told_apart),
        "probability": _rounded(explanation.probability),
        "odds": {outcome: _rounded(value) for outcome, value in explanation.odds.items()},
        "form": explanation.form,
        "relative_change": {
            band: float(value) for band, value in zip(explanation.all_bands, explanation.spectrum, strict=True)
        },
        "motion": {
            band: {name: round(value, 7) for name, value in asdict(motion).items()}
            for band, motion in motions(explanation).items()
        },
        "heldout": float(explanation.heldout),
        "registration": {name: round(float(share), 3) for name, share in asdict(explanation.registration).items()},
        "fixed": guidance.fixed,
        "appearance": appearance(explanation.registration),
        "everyday_causes": list(guidance.causes),
        "experiment": guidance.experiment,
        "field": None if explanation.field is None else field_record(explanation.field),
        "families": [
            {
                "family": r.family,
                "form": r.form,
                "surface": r.surface,
                "share": float(r.share),
                "score": float(r.score),
            }
            for r in explanation.rivals
        ],
    }


def _rounded(probability: float) -> float | None:
    """A probability for JSON; None for NaN."""
    return None if np.isnan(probability) else round(float(probability), 4)


def explanation_sentence(explanation: Explanation) -> str:
    """Finding in one or two sentences.

    Parameters
    ----------
    explanation
        The explanation.

    Returns
    -------
    str
        Family, form, region, bands and share of the excess; then the next family.
    """
    family = explanation.family_record
    if family is None:
        return _undecided(explanation) or f"No family of fields explains what remains{_believed(explanation)}."
    where = f" on {explanation.surface}" if explanation.surface else ""
    if explanation.centre_px is not None:
        where += f" about pixel ({explanation.centre_px[0]:.0f}, {explanation.centre_px[1]:.0f})"
    every = len(explanation.bands) == len(explanation.all_bands)
    bands = "all bands" if every else ", ".join(explanation.bands)
    text = (
        f"What remains looks like {family.title} ({explanation.family}: {explanation.form}){where}, "
        f"in {bands}{_believed(explanation)}. It explains {100 * explanation.share:.0f} % of the excess."
        f"{_motion_sentence(explanation)}"
    )
    if explanation.runner_up is None:
        return text
    other = explanation.rivals[1]
    if explanation.told_apart:
        return f"{text} The next best family, {other.family}, explains {100 * other.share:.0f} %."
    return f"{text} This capture cannot distinguish it from {other.family}, which explains {100 * other.share:.0f} %."


def _motion_sentence(explanation: Explanation) -> str:
    """Displacement of the band that is displaced most; empty for other patterns."""
    each = motions(explanation)
    if not each:
        return ""
    band = max(each, key=lambda name: each[name].rms_px)
    motion = each[band]
    return (
        f" The picture of {band} is displaced by {motion.rms_px:.3f} ± {motion.sigma_px:.3f} px (rms): "
        f"{motion.right_px:+.3f} px to the right and {motion.down_px:+.3f} px down, enlarged by "
        f"{1e6 * motion.enlargement:+.0f} ppm and turned by {motion.turned_deg:+.4f}° (clockwise)."
    )


def _undecided(explanation: Explanation) -> str:
    """Families that are likely together, with none likelier than not; empty without them."""
    ranked = sorted(explanation.odds.items(), key=lambda outcome: -outcome[1])
    likely = [(name, value) for name, value in ranked[:_MAX_LIKELY] if value >= _MIN_LIKELY]
    if not likely or likely[0][0] in (NONE, SOUND):
        return ""
    names = {NONE: "none of the families", SOUND: "flaws of the picture"}
    names |= {name: f"{family.title} [{name}]" for name, family in families().items()}
    parts = [f"{names[name]} ({value:.2f})" for name, value in likely]
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    return (
        "Families of fields explain what remains, but this capture does not distinguish them: none is likelier than "
        f"not. The likeliest (probability) are {listed}."
    )


def _believed(explanation: Explanation) -> str:
    """Probability of the family in words; empty where not judged."""
    return "" if np.isnan(explanation.probability) else f" (probability {explanation.probability:.2f})"


def laboratory_sentences(explanation: Explanation) -> tuple[str, ...]:
    """Place, sign and scaling of what remains, and its everyday causes.

    Parameters
    ----------
    explanation
        The explanation.

    Returns
    -------
    tuple
        Two sentences; the experiment that settles it is a step of the report.
    """
    guidance = advice(explanation)
    first, *middle, last = guidance.causes
    causes = f"{', '.join([first, *middle])} or {last}"
    look = appearance(explanation.registration)
    return (f"It is fixed {guidance.fixed}; {look}.", f"Everyday causes of such a pattern are {causes}.")


def explanation_sections(explanation: Explanation | None) -> list[ReportSection]:
    """Section on the difference that no effect explains.

    Parameters
    ----------
    explanation
        The explanation; None where nothing remains.

    Returns
    -------
    list
        One section with the explained change, the rest and all families; empty where nothing remains.
    """
    if explanation is None:
        return []
    rows = [
        (
            r.family,
            Cell(r.form, wrap=True),
            r.surface or "–",
            number(100 * r.share, 1),
            significant(r.score, 5),
        )
        for r in explanation.rivals
    ]
    table = ReportTable(
        ("Family", "Form", "Surface", "Share of the excess, %", "2 ln evidence"),
        rows,
        "Each family is fitted alone in its best form, with camera and lamp free. A family may explain up to 3 % less "
        "than the closest fit without penalty, for the errors of shapes.",
    )
    if explanation.family_record is None:
        sentences = [explanation_sentence(explanation), *laboratory_sentences(explanation)]
        return [ReportSection("What no effect explains", sentences, [table])]
    strength = np.nansum((explanation.change / explanation.sigma) ** 2, axis=(1, 2))
    bands = sorted(np.argsort(strength)[::-1][:_MAX_MAPS])
    explained = {explanation.all_bands[b]: (explanation.change / explanation.sigma)[b] for b in bands}
    rest = {explanation.all_bands[b]: explanation.remaining[b] for b in bands}
    scale = residual_scale("change / σ")
    return [
        ReportSection(
            "What no effect explains",
            [explanation_sentence(explanation), *laboratory_sentences(explanation)],
            [
                map_row(explained, scale, "Change that the family explains, over the noise of a pixel."),
                map_row(rest, scale, "Photograph minus rendering with this change, with the same colour scale."),
                table,
            ],
        )
    ]
