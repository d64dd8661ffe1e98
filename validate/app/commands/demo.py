"""``cbox demo``: all steps on the bundled capture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import (
    require_folder,
    warn_unless_compiled,
)

__all__ = ["demo"]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the report and the pictures.")] = Path("demo-report"),
) -> None:
    """Run all steps on the bundled capture: calibrate, validate, diagnose, simulate."""
    from .demo_chain import run_demo

    require_folder(out)
    warn_unless_compiled()
    run_demo(out)
