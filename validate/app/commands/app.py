"""All commands of ``cbox``, and their exit codes."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Sequence

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Cancelled
from rich.text import Text

from ..terminal import command_line, require_option_numbers, this_run
from .add import add
from .batch import batch
from .calibrate import calibrate
from .capture import capture
from .compare import compare
from .console import errors
from .dataset import dataset
from .demo import demo
from .diagnose import diagnose
from .effects import effects
from .export import export
from .hyperspectral import hyperspectral
from .import_ import import_
from .regress import regress
from .render import render
from .renderers import renderers
from .reveal import reveal
from .simulate import simulate
from .studio import studio
from .trend import trend
from .validate import validate
from .verify import verify

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

__all__ = ["app", "run"]

#: Least limit of address space, bytes: below it a validation of 128 x 128 pixels ended in a segmentation fault.
_MIN_ADDRESS_SPACE = 2 * 2**30
#: The same for the workbench, whose kernels and pictures stay in memory: it was aborted by a library at 2 GiB.
_MIN_ADDRESS_SPACE_STUDIO = 4 * 2**30
#: Exit code of an interrupted command, as of a shell: 128 and the number of SIGINT.
_INTERRUPTED = 130

#: Functions of all commands, in the sequence of the help.
_COMMANDS = (
    demo,
    validate,
    calibrate,
    hyperspectral,
    import_,
    compare,
    verify,
    batch,
    diagnose,
    studio,
    trend,
    regress,
    export,
    renderers,
    render,
    simulate,
    dataset,
    capture,
    reveal,
    add,
    effects,
)
#: The command line.
app = command_line(
    "Measure how far a physically based rendering is from photographs of a real Cornell box, where, and why.",
    _COMMANDS,
)


def run(arguments: Sequence[str] | None = None, pressed: Sequence[int] = ()) -> None:
    """Run one command and end with its exit code.

    Exit codes: 0 done, 1 a check failed, 2 bad input, 3 an error of the program (with a trace file), 130 interrupted.

    Parameters
    ----------
    arguments
        Arguments of the command; None for those of sys.argv.
    pressed
        One number for each Ctrl-C until now, see ``cli.main``.
    """
    command = sys.argv[1:] if arguments is None else list(arguments)
    this_run.begin(command)
    try:
        _require_letters(command)
        _require_address_space(_MIN_ADDRESS_SPACE_STUDIO if command[:1] == ["studio"] else _MIN_ADDRESS_SPACE)
        require_option_numbers(command, _COMMANDS)
        app(prog_name="cbox", args=command)
    except SystemExit as ended:
        if ended.code == _INTERRUPTED:  # Typer ends an interrupted command without a message
            errors.print("interrupted")
        raise
    except InputError as error:
        _fail(str(error))
    except Cancelled:
        errors.print("Stopped. No unfinished file is left.")
        sys.exit(_INTERRUPTED)
    except BrokenPipeError:  # the reader of the output has ended; results are in their files
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        _fail(f"{error.filename or 'a file'}: {error.strerror or error}")
    except MemoryError:
        _fail("the input needs more memory than this computer has. Use a smaller picture or fewer wavelengths.")
    except (KeyboardInterrupt, Exception) as error:
        if isinstance(error, KeyboardInterrupt) or pressed:
            errors.print("interrupted")
            sys.exit(_INTERRUPTED)
        _report_fault(error)


def _require_address_space(least_bytes: int) -> None:
    """Raise InputError for a limit of address space that compiled libraries do not survive."""
    if resource is None:
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < least_bytes:
        size, least = (f"{value / 2**30:.3g} GiB of address space" for value in (limit, least_bytes))
        raise InputError("ulimit -v", size, f"at least {least}", "Set ulimit -v unlimited.")


def _require_letters(arguments: Sequence[str]) -> None:
    """Raise InputError for names that the locale cannot read, since libraries refuse them later."""
    for name in arguments:
        if any("\ud800" <= letter <= "\udfff" for letter in name):
            encoding = sys.getfilesystemencoding()
            problem = f"bytes that are not letters of the locale's encoding, {encoding}"
            raise InputError(name, problem, "a name in that encoding", "Set LC_ALL=C.UTF-8, or rename the file.")


def _report_fault(error: Exception) -> None:
    """Write the trace of a program error to a file, and print its path in one line."""
    if this_run.verbose:
        traceback.print_exception(error)
    handle, name = tempfile.mkstemp(prefix="cboxlab-trace-", suffix=".txt")
    with os.fdopen(handle, "w", encoding="utf-8", errors="replace") as trace:
        trace.write(f"cbox {' '.join(sys.argv[1:])}\n\n")
        traceback.print_exception(error, file=trace)
    message = f"{type(error).__name__}: {str(error)[:200]}. This is an error of the program: please send {name}"
    errors.print(Text.assemble(("fault: ", "bold red"), message), soft_wrap=True)
    sys.exit(3)


def _fail(message: str) -> None:
    """Print an error and end with exit code 2."""
    errors.print(Text.assemble(("error: ", "bold red"), message), soft_wrap=True)
    sys.exit(2)
