"""``cbox studio``: the workbench in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import NoCacheOption
from .console import (
    say,
)

__all__ = ["studio"]


def studio(
    capture: Annotated[
        Path | None,
        typer.Argument(
            help="A folder of the capture format, or of a saved study; others open from the page.", show_default=False
        ),
    ] = None,
    *,
    model: Annotated[Path | None, typer.Option(help="Model or scene file (TOML); default the capture's scene.")] = None,
    folder: Annotated[
        Path, typer.Option(help="Captures and models below it can be opened from the page, results saved.")
    ] = Path(),
    host: Annotated[str, typer.Option(help="Address to listen at; other machines reach only others.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 for any free one.", min=0, max=65535)] = 0,
    no_token: Annotated[bool, typer.Option("--no-token", help="Answer anyone who can reach the address.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, open no browser.")] = False,
    no_cache: NoCacheOption = False,
) -> None:
    """Compare, move effects and see the error follow, live in the browser."""
    from cboxlab.rendering.device import variant

    from ...predict import default_cache

    try:
        from ..studio import Workbench, serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        hint = "Install them with: pip install 'cboxlab[studio]'"
        raise InputError("cbox studio", f"no package {error.name}", "starlette and uvicorn", hint) from None
    if not folder.is_dir():
        raise InputError("--folder", f"'{folder}'", "a folder that is there")
    if capture is not None and not ((capture / "capture.toml").exists() or (capture / "study.json").exists()):
        raise InputError(capture, "no capture.toml and no study.json", "a capture's folder, or a saved study's")
    variant.require_compiled("cbox studio")
    bench = Workbench(folder.resolve(), None if no_cache else default_cache())
    serve(
        bench,
        None if capture is None else lambda progress: bench.open(capture, model, progress),
        lambda address: say(f"The workbench: {address}\nCtrl-C ends it."),
        host=host,
        port=port,
        token=not no_token,
        browser=not no_browser,
    )
