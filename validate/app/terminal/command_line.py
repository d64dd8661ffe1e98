"""Command line of a list of commands, with common options, plain help and shell completion."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from .destinations import require_file
from .number_options import command_name
from .output import STANDARD_OUTPUT, show_results_apart, this_run

__all__ = ["JsonOption", "command_line"]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only. Results are in their files.")]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        help="Print the duration of each stage, the library's log, and the trace of a program error.",
    ),
]


def _checked_destination(path: Path | None) -> Path | None:
    """Require a writable file; print messages to standard error if JSON goes to standard output."""
    if path == STANDARD_OUTPUT:
        show_results_apart()
    elif path is not None:
        require_file(path)
    return path


#: Option of every command with results, which ``give_json`` writes.
JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        help="Write the results as JSON to this file. With -, they go to standard output.",
        callback=_checked_destination,
    ),
]


def command_line(help_text: str, commands: Iterable[Callable[..., Any]]) -> typer.Typer:
    """Application of commands, with ``--quiet``, ``--verbose``, ``--version`` and completion.

    Help is plain text: rich markup would remove text in square brackets, such as the names of tables in a file.

    Parameters
    ----------
    help_text
        Help of the program.
    commands
        Functions whose docstrings and annotations are the help of the commands.

    Returns
    -------
    typer.Typer
        The application.
    """
    app = typer.Typer(
        help=help_text,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_root)
    for command in commands:
        summary = inspect.cleandoc(command.__doc__ or "").partition("\n")[0]  # else it is cut to one line
        app.command(command_name(command), short_help=summary)(_with_common_options(command))
    return app


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"cbox {version('cboxlab')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and stop.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Options of the program itself."""


def _with_common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Command with the options ``--quiet`` and ``--verbose``, which set ``this_run``."""
    command_signature = inspect.signature(command, eval_str=True)
    common = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("quiet", Quiet), ("verbose", Verbose))
    ]

    @functools.wraps(command)
    def run(*arguments: Any, quiet: bool = False, verbose: bool = False, **keywords: Any) -> Any:
        if verbose:
            this_run.be_verbose()
        if quiet:
            this_run.be_quiet()
        return command(*arguments, **keywords)

    signature = command_signature.replace(parameters=[*command_signature.parameters.values(), *common])
    run.__signature__ = signature  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run
