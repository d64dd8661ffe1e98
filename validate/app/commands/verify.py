"""``cbox verify``: results and inputs held against their manifest."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import JsonOption
from .console import (
    give_json,
    say,
)

if TYPE_CHECKING:
    pass

__all__ = ["verify"]


def verify(
    results: Annotated[
        Path,
        typer.Argument(
            help="A folder of results, a cube, a raw frame, or what regress wrote with --json or --junit.",
            show_default=False,
        ),
    ],
    *,
    json: JsonOption = None,
) -> None:
    """Check that results, and the inputs they were made from, are those of their manifest.

    Exit code 0 unchanged, 1 something changed or is gone, 2 no manifest.
    """
    from ...api import verify as run

    found = run(results)
    for line in found.lines():
        say(line)
    give_json(json, {"sound": found.sound, **asdict(found)})
    if not found.sound:
        raise typer.Exit(1)
    say(f"{results}: {found.outputs} results and {found.inputs} inputs are unchanged.")
