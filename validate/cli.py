"""The command line: ``cbox``. A user's mistake ends in one message and exit code 2."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

# before NumPy: threads that wait for work in its matrix products take the cores from ray tracing
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import typer
from cboxlab.scenes.errors import InputError
from rich.text import Text

from . import (
    commands_diagnosis,
    commands_forward,
    commands_hyperspectral,
    commands_measured,
    commands_model,
    commands_sensor,
)
from .console import errors

__all__ = ["app", "main"]

app = typer.Typer(
    help="How far a physically based rendering is from the real thing, where, and why.",
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
)  # fmt: skip

for command in (
    commands_measured.demo,
    commands_measured.validate,
    commands_measured.calibrate,
    commands_hyperspectral.hyperspectral,
    commands_measured.compare,
    commands_diagnosis.diagnose,
    commands_forward.render,
    commands_sensor.simulate,
    commands_forward.capture,
    commands_forward.reveal,
    commands_model.add,
    commands_model.effects,
):
    app.command()(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. arguments : sys.argv's where None. Exit codes: 0 done, 1 a check failed, 2 bad input."""
    try:
        app(args=None if arguments is None else list(arguments))
    except InputError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'a file'}: {error.strerror or error}")


def _fail(message: str) -> None:
    errors.print(Text.assemble(("error: ", "bold red"), message), soft_wrap=True)
    sys.exit(2)
