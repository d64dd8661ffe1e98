"""The command line from its commands: options that all of them take, help as plain text, names of the shell."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from .output import STANDARD_OUTPUT, show_results_apart, this_run

__all__ = ["JsonOption", "command_line"]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only; results are in their files.")]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Say what each stage took; print the trace of a program fault."),
]


def _keep_standard_output_clear(path: Path | None) -> Path | None:
    if path == STANDARD_OUTPUT:
        show_results_apart()
    return path


#: Of every command that finds something: ``give_json`` writes it.
JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        help="Write what was found as JSON to this file; - for standard output.",
        callback=_keep_standard_output_clear,
    ),
]


def command_line(help_text: str, commands: Iterable[Callable[..., Any]]) -> typer.Typer:
    """An application of these commands, each with ``--quiet`` and ``--verbose``; ``--version`` and completion.

    Help is printed as plain text: rich markup would swallow what stands in square brackets, such as tables of a file.
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
        name = command.__name__.rstrip("_").replace("_", "-")  # import_ is `import`, a word of Python
        app.command(name, short_help=summary)(_with_common_options(command))
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
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
    """The command with the options ``--quiet`` and ``--verbose``, which set ``this_run``."""
    own = inspect.signature(command, eval_str=True)
    common = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("quiet", Quiet), ("verbose", Verbose))
    ]

    @functools.wraps(command)
    def run(*arguments: Any, quiet: bool = False, verbose: bool = False, **keywords: Any) -> Any:
        this_run.verbose = verbose
        if quiet:
            this_run.be_quiet()
        return command(*arguments, **keywords)

    signature = own.replace(parameters=[*own.parameters.values(), *common])
    run.__signature__ = signature  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run
