"""``cbox regress``: the change between two renderings of one scene."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..terminal import STANDARD_OUTPUT
from .arguments import DeclareRegressedOption, JsonOption
from .console import (
    bar,
    declared_pair,
    give_json,
    options,
    print_result,
    require_file,
    say,
)

if TYPE_CHECKING:
    from ...compare_renders.regress import Spot
    from ...report import ReportSection

__all__ = ["regress"]


def regress(
    baseline: Annotated[
        str,
        typer.Argument(
            help="Spectral cube (.nc, .exr, .hdr) or colour picture of any scene (.exr, .hdr). For several independent "
            "pictures of one view, join their names by commas, or give their folder. You can also give a command that "
            "writes pictures to {out}, a model file (.toml), or cornell-box.",
            show_default=False,
        ),
    ],
    candidate: Annotated[str, typer.Argument(help="The same for the changed renderer.", show_default=False)],
    *,
    json: JsonOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the verdict and its tables as a page for the browser.")
    ] = None,
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
    same_seeds: Annotated[
        bool,
        typer.Option(
            "--same-seeds",
            help="Compare cube by cube. Both sides must list cubes of the same seeds in the same order.",
        ),
    ] = False,
    declare: DeclareRegressedOption = None,
) -> None:
    """Test whether two renderings have the same light, and name the change.

    The exit code is 0 for the same light, 1 for different light, and 2 for bad input.
    """
    from ...compare_renders.regress import SIDES, github_lines, input_files, regress_inputs, write_junit

    declared = declared_pair(declare, SIDES)
    for path in (junit, out):
        if path is not None:
            require_file(path)
    with options(camera="--camera"), bar("comparing") as report:
        outcome = regress_inputs(
            baseline, candidate, model, camera, false_alarms, report, declared=declared, same_seeds=same_seeds
        )
    give_json(json, outcome.to_dict())
    if junit is not None:
        write_junit(junit, outcome)
    if out is not None:
        from ...report import write_tables  # slow to import

        pictures = [] if outcome.spot is None else [_where(outcome.spot)]
        title = f"{_short(candidate)} against {_short(baseline)}"
        write_tables(out, title, outcome.lines(), outcome.tables(), pictures)
    written = [path for path in (json, junit, out) if path is not None and path != STANDARD_OUTPUT]
    if written:
        from ...api import write_manifest  # slow to import

        inputs = [path for text in (baseline, candidate, *filter(None, [model])) for path in input_files(text)]
        for path in written:
            write_manifest(path, [path], [*inputs, *([] if camera is None else [camera])])
    print_result(outcome.lines(), outcome.tables())
    if os.environ.get("GITHUB_ACTIONS"):
        for line in github_lines(outcome):
            say(line)
    if not outcome.same:
        raise typer.Exit(1)


def _short(side: str) -> str:
    """Side for a title: a command, or the first of several files and their number."""
    first, *others = [side] if "{out}" in side else side.split(",")
    return f"{first} and {len(others)} more" if others else first


def _where(spot: Spot) -> ReportSection:
    """Section of the page with a map of the difference, next to the baseline."""
    from ...report import ReportSection, map_next_to  # slow to import

    of_band = f" in band {spot.band}" if spot.band else ""
    pixels = f"smoothed by a Gaussian of {spot.width_px:g} px" if spot.width_px else "pixel by pixel"
    caption = (
        f"Candidate less baseline{of_band} over its standard error, {pixels}: the width at which the difference is "
        f"clearest. Red is brighter, blue darker. Noise alone rarely exceeds ±4.5."
    )
    light = f"Baseline, light{of_band or ' of all bands'}; four times its median is white"
    signed = f"Candidate less baseline, {pixels}"
    row = map_next_to((light, spot.baseline), (signed, spot.sigmas), "(candidate − baseline) / σ", caption)
    return ReportSection("Where the pictures differ", (), (row,))
