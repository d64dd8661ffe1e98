"""``cbox verify``: compare results and inputs with their manifest."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .arguments import JsonOption
from .console import (
    give_json,
    say,
)

__all__ = ["verify"]


def verify(
    results: Annotated[
        Path,
        typer.Argument(
            help="Folder of results, cube, raw frame, or file that `cbox regress` wrote with --json or --junit.",
            show_default=False,
        ),
    ],
    *,
    json: JsonOption = None,
) -> None:
    """Check whether results and their inputs are unchanged since a command wrote the results.

    The manifest next to the results lists both. The exit code is 0 if nothing changed, 1 if a file changed or is gone,
    and 2 without a manifest.
    """
    from ...api import verify as run

    verification = run(results)
    for line in verification.lines():
        say(line)
    give_json(json, {"sound": verification.sound, **asdict(verification)})
    if not verification.sound:
        raise typer.Exit(1)
    say(f"{results}: {verification.outputs} results and {verification.inputs} inputs are unchanged.")
