"""Prints a validation or a diagnosis in the terminal: verdict, headline figures, tables."""

from __future__ import annotations

import math

from cboxlab.calibration.result import Calibration

from ...compare import HEADLINE, Validation, failures
from ...diagnose import Diagnosis
from ...report import chi2_by_place, finding_sentences, named_bands, ranked_values, step_name, verdict
from .console import console, data_table, print_table, say

__all__ = ["print_diagnosis", "print_failures", "print_suspicions", "print_validation"]


def print_validation(result: Validation) -> None:
    """Print suspected errors of the capture, the verdict, the headline figures, the tables, where the model fails."""
    print_suspicions(result.prepared.calibration)
    c = result.comparison
    console.print(verdict(c).headline, style="bold")
    say(
        f"χ² per degree of freedom {c.chi2.per_dof:.3f} ({chi2_by_place(c)}); mean {HEADLINE.label} "
        f"{c.colour[HEADLINE.id].mean:.2f} (noise alone {c.colour_noise[HEADLINE.id].mean:.2f}); "
        f"render/sensor noise {c.render_sigma_over_sensor_sigma:.2f}; "
        f"lamp × {result.fit.lamp_scale:.4f}; {result.seconds:.0f} s"
    )
    bands = named_bands(c.bands, result.prepared.responses)
    table = data_table(
        f"{result.prepared.calibration.capture.folder.name}: (measured − rendered) / rendered, interiors, %; "
        "bands in nm",
        "surface",
        *(name.removesuffix(" nm") for _, name in bands),
        HEADLINE.label,
        "χ²/dof",
    )
    for name, row in c.by_surface.items():
        table.add_row(
            name,
            *(_known(100 * row.relative[i], "+.2f") for i, _ in bands),
            _known(row.colour[HEADLINE.id], ".2f"),
            _known(row.chi2.per_dof, ".2f"),
        )
    print_table(table)
    print_failures(result)


def _known(value: float, form: str) -> str:
    """A dash for a surface of which no interior pixel, or no pixel at all, is seen."""
    return f"{value:{form}}" if math.isfinite(value) else "–"


def print_failures(result: Validation) -> None:
    """Print the ranked list of where the model fails."""
    for rank, failure in enumerate(failures(result)[1], 1):
        say(f"{rank}. {failure.sentence}")


def print_suspicions(calibration: Calibration) -> None:
    """Print the suspected errors of the capture, if any."""
    if calibration.suspicions:
        console.print("Suspected errors of the capture:", style="bold")
    for suspicion in calibration.suspicions:
        say(f"! {suspicion}")


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the findings, the ranking and the path."""
    for sentence in finding_sentences(diagnosis):
        say(sentence)
    table = data_table("Effects tried alone", "effect", "parameters", "χ²/dof", "probability")
    table.columns[1].no_wrap = False
    for r in diagnosis.ranking[:6]:
        table.add_row(r.effect, ranked_values(r), f"{r.chi2_per_dof:.4f}", f"{100 * r.probability:.1f} %")
    print_table(table)
    say(
        "Above, χ²/dof counts what the render itself may be wrong by as noise, and camera and lamp are refitted with "
        "each effect; below it counts the noise alone."
    )
    path = data_table(
        "Error after each step", "model", "χ²/dof", HEADLINE.label, "noise alone", "camera, lamp from survey, σ"
    )
    for step in diagnosis.path:
        c = step.comparison
        path.add_row(
            step_name(step),
            f"{c.chi2.per_dof:.3f}",
            f"{c.colour[HEADLINE.id].mean:.3f}",
            f"{c.colour_noise[HEADLINE.id].mean:.3f}",
            f"{step.prior_pull:.1f}",
        )
    print_table(path)
