"""``cbox validate``: calibrate a capture, render its model, compare, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import CaptureFolder, DeclareOption, JsonOption, NoCacheOption, RenderOption
from .console import (
    bar,
    declared_files,
    give_json,
    load_inputs,
    options,
    print_result,
    require_folder,
    say,
    warn_unless_compiled,
)

__all__ = ["validate"]


def validate(
    capture: CaptureFolder,
    *,
    model: Annotated[
        Path | None,
        typer.Option(help="Model or scene file (TOML). The default is the scene that the capture states."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for report.html, metrics.json and maps.")] = Path("validation"),
    render: RenderOption = None,
    no_cache: NoCacheOption = False,
    declare: DeclareOption = None,
    json: JsonOption = None,
) -> None:
    """Calibrate a capture, render a model through its camera, compare both, and write a report."""
    from ...api import validate as run
    from ...api import write_manifest
    from ...predict import default_cache

    require_folder(out)
    declared = declared_files(declare)
    (checked, (loaded,)), cache = load_inputs(model, [capture]), None if no_cache else default_cache()
    warn_unless_compiled()
    with options(render="--render"), bar("calibrating") as report:
        result = run(loaded, model=checked, render=render, cache=cache, declared=declared, progress=report)
        report.stage("writing the report")
        inputs = [path for path in (capture, model, render, *checked.files) if path is not None]
        write_manifest(out, result.write(out), inputs, seed=checked.render.seed, seconds=result.validation.seconds)
    print_result(result.lines(), result.tables())
    give_json(json, result.to_dict())
    say(f"Report: {out / 'report.html'}")
