"""``cbox diagnose``: the physical effects that a model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import DeclareOption, JsonOption, NoCacheOption, RenderOption
from .console import (
    bar,
    declared_files,
    give_json,
    load_inputs,
    options,
    print_result,
    require_folder,
    say,
)

__all__ = ["diagnose"]


def diagnose(
    captures: Annotated[
        list[Path],
        typer.Argument(
            metavar="capture...",
            help="Folder of a capture, with capture.toml. Further captures of the same box, with other exposures, "
            "apertures or camera positions, separate causes that the first capture alone cannot separate.",
            show_default=False,
        ),
    ],
    *,
    model: Annotated[
        Path | None,
        typer.Option(help="Model or scene file (TOML). The default is the scene that the capture states."),
    ] = None,
    json: JsonOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html, metrics.json, maps and the final model.toml.")
    ] = None,
    render: RenderOption = None,
    no_cache: NoCacheOption = False,
    declare: DeclareOption = None,
) -> None:
    """Find the physical effects that a model lacks, add them, and print how the error decreases."""
    from cboxlab.rendering.device import variant

    from ...api import diagnose as run
    from ...api import write_manifest
    from ...predict import default_cache

    if out is not None:
        require_folder(out)
    declared = declared_files(declare)
    (checked, loaded), cache = load_inputs(model, captures), None if no_cache else default_cache()
    variant.require_compiled("cbox diagnose")
    with options(render="--render"), bar("calibrating") as report:
        result = run(*loaded, model=checked, render=render, cache=cache, declared=declared, progress=report)
        if out is not None:
            report.stage("writing the report")
            inputs = [*captures, *checked.files, *(path for path in (model, render) if path is not None)]
            write_manifest(out, result.write(out), inputs, seed=checked.render.seed)
    print_result(result.lines(), result.tables())
    give_json(json, result.to_dict())
    if out is not None:
        say(f"Report: {out / 'report.html'}. Final model: {out / 'model.toml'}")
