"""The command that names what is missing: diagnose."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .commands_measured import NoCacheOption, RenderOption
from .console import bar, require_compiled, require_folder, say

__all__ = ["diagnose"]


def diagnose(
    capture: Annotated[
        Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)
    ],
    model: Annotated[
        Path | None, typer.Option(help="Model file (TOML); the published box where left out.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write the diagnosis as JSON to this file.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html, metrics.json, maps and the final model.toml.")
    ] = None,
    render: RenderOption = None,
    no_cache: NoCacheOption = False,
) -> None:
    """Which physical effect is missing: name it, add it, and show the error falling."""
    from .diagnosis import diagnose as run
    from .diagnosis_output import diagnosis_sections, path_steps, print_diagnosis, write_diagnosis
    from .model import Model, load_model, write_model
    from .picture_cache import default_cache
    from .pipeline import validate, write_validation
    from .summary import print_failures

    if out is not None:
        require_folder(out)
    chosen = Model() if model is None else load_model(model)
    require_compiled()
    with bar("validating") as report:
        validation = validate(capture, chosen, report, render, None if no_cache else default_cache())
    with bar("diagnosing") as report:
        diagnosis = run(validation, report)
    print_failures(validation)
    print_diagnosis(diagnosis)
    if json is not None:
        write_diagnosis(json, diagnosis)
    if out is not None:
        write_validation(validation, out, diagnosis_sections(diagnosis), path_steps(diagnosis))
        write_model(out / "model.toml", diagnosis.model)
        write_diagnosis(out / "diagnosis.json", diagnosis)
        say(f"Report: {out / 'report.html'}; the final model: {out / 'model.toml'}")
