"""``cbox studio``: workbench in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import quote

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
            help="Folder of a capture, of a saved study, or of frames without a capture.toml, for which the page has a "
            "form. You can open others from the page.",
            show_default=False,
        ),
    ] = None,
    *,
    model: Annotated[
        Path | None, typer.Option(help="Model or scene file (TOML). The default is the scene that the capture states.")
    ] = None,
    folder: Annotated[
        Path, typer.Option(help="Folder below which the page opens captures and models, and saves results.")
    ] = Path(),
    host: Annotated[
        str,
        typer.Option(help="Address to listen on. With the default, only this computer can connect."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on. 0 takes any free port.", min=0, max=65535)] = 0,
    no_token: Annotated[
        bool,
        typer.Option(
            "--no-token",
            help="Answer without the secret in the address. Then anyone who reaches the address can use the page.",
        ),
    ] = False,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address without opening a browser.")
    ] = False,
    no_cache: NoCacheOption = False,
) -> None:
    """Open the workbench in the browser: add effects to a model, move them, and watch the error."""
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
        raise InputError("--folder", f"'{folder}'", "an existing folder")
    page = "" if capture is None else _first_page(capture, folder.resolve())
    variant.require_compiled("cbox studio")
    bench = Workbench(folder.resolve(), None if no_cache else default_cache())
    serve(
        bench,
        None if capture is None or page else lambda progress: bench.open(capture, model, progress),
        lambda address: say(f"Workbench: {address}\nPress Ctrl-C to end it."),
        host=host,
        port=port,
        token=not no_token,
        browser=not no_browser,
        page=page,
    )


def _first_page(capture: Path, root: Path) -> str:
    """Page with the form for a folder of frames; "" for a capture or a saved study."""
    if (capture / "capture.toml").exists() or (capture / "study.json").exists():
        return ""
    if not capture.is_dir() or not any(path.is_file() for path in (*capture.glob("*"), *capture.glob("frames/*"))):
        expected = "the folder of a capture, of a saved study, or of frames"
        raise InputError(capture, "no capture.toml, no study.json and no frames", expected)
    if not capture.resolve().is_relative_to(root):
        raise InputError(capture, "a folder of frames outside --folder", f"a folder below {root}", "State --folder.")
    return f"first.html?folder={quote(capture.resolve().relative_to(root).as_posix())}"
