"""Numbers of the command line, spelled as in a table."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, get_args

from cboxlab.utils.errors import InputError
from cboxlab.utils.numbers import number_of, whole_number_of
from typer.models import OptionInfo

__all__ = ["command_name", "require_option_numbers"]


def command_name(command: Callable[..., Any]) -> str:
    """Name of a command by its function: ``import_`` is ``import``, a word of Python.

    Parameters
    ----------
    command
        Function of the command.

    Returns
    -------
    str
        The name.
    """
    return command.__name__.rstrip("_").replace("_", "-")


def require_option_numbers(arguments: Sequence[str], commands: Iterable[Callable[..., Any]]) -> None:
    """Check the numbers of a command's options, before Python's own conversion takes 1_6 for 16.

    Parameters
    ----------
    arguments
        Arguments of the program.
    commands
        Functions of all commands.

    Raises
    ------
    InputError
        For a value that is no number.
    """
    command = next((member for member in commands if arguments and command_name(member) == arguments[0]), None)
    kinds = {} if command is None else dict(_number_options(command))
    for position, argument in enumerate(arguments):
        if argument == "--":
            return
        option, joined, value = argument.partition("=")
        if option not in kinds or not (joined or position + 1 < len(arguments)):
            continue
        text = value if joined else arguments[position + 1]
        if kinds[option] is int and whole_number_of(text) is None:
            raise InputError(option, repr(text), "a whole number, such as 16")
        if math.isnan(number_of(text)):
            raise InputError(option, repr(text), "a number, such as 0.5")


def _number_options(command: Callable[..., Any]) -> Iterator[tuple[str, type]]:
    """Names of the options of a command that are numbers, with ``int`` or ``float``."""
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        annotation, *details = get_args(parameter.annotation) or (parameter.annotation,)
        kinds = {int, float} & {annotation, *get_args(annotation)}
        option = next((detail for detail in details if isinstance(detail, OptionInfo)), None)
        if kinds and option is not None:
            for name in option.param_decls or (f"--{parameter.name.replace('_', '-')}",):
                yield name, int if kinds == {int} else float
