"""``cbox regress``: the change between two renderings of one scene."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..terminal import STANDARD_OUTPUT
from .arguments import DeclarePairOption, JsonOption
from .console import (
    bar,
    data_table,
    declared_pair,
    give_json,
    options,
    print_table,
    require_folder,
    say,
)

if TYPE_CHECKING:
    from ...compare_renders.regress import Outcome, PooledMean

__all__ = ["regress"]

#: Largest number of rows in the table of deciding statistics.
_MOST_ROWS = 8


def regress(
    baseline: Annotated[
        str,
        typer.Argument(
            help="Spectral cube (.nc, .exr, .hdr) or colour picture (.exr, .hdr). Independent cubes of one picture can "
            "be joined by commas, or be a folder. It may also be a command that writes them to {out}, a model file "
            "(.toml), or cornell-box.",
            show_default=False,
        ),
    ],
    candidate: Annotated[str, typer.Argument(help="The same for the changed renderer.", show_default=False)],
    *,
    json: JsonOption = None,
    junit: Annotated[Path | None, typer.Option(help="Write the verdict as JUnit XML.")] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="Model file or packaged scene that the cubes show. It gives the surfaces, and helps to name a change."
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="Camera file (.json), or capture folder for its camera and lamp. The default is the published camera."
        ),
    ] = None,
    false_alarms: Annotated[float, typer.Option(help="False-alarm rate of the verdict.", min=1e-9, max=0.5)] = 1e-3,
    declare: DeclarePairOption = None,
) -> None:
    """Test whether a rendering algorithm changed its result.

    The exit code is 0 for the same light, 1 for different light, and 2 for bad input.
    """
    from ...api import write_manifest
    from ...compare_renders.regress import SIDES, github_lines, input_files, regress_inputs, write_junit

    declared = declared_pair(declare, SIDES)
    for path in (json, junit):
        if path is not None:
            require_folder(path.parent)
    with options(camera="--camera"), bar("comparing") as report:
        outcome = regress_inputs(baseline, candidate, model, camera, false_alarms, report, declared=declared)
    give_json(json, outcome.to_dict())
    if junit is not None:
        write_junit(junit, outcome)
    inputs = [path for text in (baseline, candidate, *filter(None, [model])) for path in input_files(text)]
    for path in (json, junit):
        if path is not None and path != STANDARD_OUTPUT:
            write_manifest(path, [path], [*inputs, *([] if camera is None else [camera])])
    _print(outcome)
    if os.environ.get("GITHUB_ACTIONS"):
        for line in github_lines(outcome):
            say(line)
    if not outcome.same:
        raise typer.Exit(1)


def _print(outcome: Outcome) -> None:
    from ...compare_renders.regress import UNKNOWN, as_percent, change_text

    whole = outcome.whole
    size = as_percent(whole.difference, "the baseline", unit="%")
    say(f"{'SAME' if outcome.same else 'DIFFERENT'}: mean light {size} ± {whole.sigma:.3%}")
    if outcome.same:
        say(f"The mean light agrees within {outcome.equivalence_95:.3%} at 95 %.")
    say(f"Detectable even change of the light: {outcome.would_have_seen:.3%} (in 90 of 100 runs).")
    table = data_table("Surfaces", "surface", "difference, %", "± %", "sigmas", "detectable, %")
    for row in outcome.of_kind("surface"):
        table.add_row(row.name, *_cells(row))
    if outcome.of_kind("surface"):
        print_table(table)
    if not outcome.same:
        table = data_table("What decided", "pool", "difference, %", "± %", "sigmas", "detectable, %")
        for row in outcome.deciding[:_MOST_ROWS]:
            table.add_row(f"{row.kind}: {row.name}" + (f" ({row.unit})" if row.unit != "1" else ""), *_cells(row))
        print_table(table)
        for index, named in enumerate(outcome.named[:3]):
            start = "Cause" if named.change == UNKNOWN else "Named" if named.fits else "Most like"
            start = start if index == 0 else f"or {start[0].lower()}{start[1:]}"
            say(f"{start}: {change_text(named)}, probability {named.probability:.2f}")
        if outcome.fits is not None and outcome.left_chi2_per_number == outcome.left_chi2_per_number:
            fit = "it fits" if outcome.fits else "it does not fit"
            say(f"The best name leaves a χ² per number of {outcome.left_chi2_per_number:.2f} (noise: about 1): {fit}.")
    if outcome.outliers:
        say(
            f"• {outcome.outliers} outlying pixels (fireflies) are not included in the means; they contain "
            f"{outcome.outlier_share:+.3%} of the light"
        )
    for note in outcome.notes:
        say(f"• {note}")


def _cells(row: PooledMean) -> tuple[str, ...]:
    from ...compare_renders.regress import as_percent

    percent = 100.0 if row.unit == "1" else 1.0
    size = as_percent(row.difference, "it", ".3g") if row.unit == "1" else f"{row.difference:.3g}"
    numbers = (percent * row.sigma, row.statistic, percent * row.detectable)
    return (size, *(f"{value:.3g}" for value in numbers))
