"""What all commands share in the terminal: output and its loudness, stages of a computation, JSON, options."""

from .command_line import JsonOption, command_line
from .output import STANDARD_OUTPUT, console, data_table, errors, give_json, print_result, print_table, say, this_run
from .stages import Stages, told_time, watch_stages

__all__ = [
    "STANDARD_OUTPUT",
    "JsonOption",
    "Stages",
    "command_line",
    "console",
    "data_table",
    "errors",
    "give_json",
    "print_result",
    "print_table",
    "say",
    "this_run",
    "told_time",
    "watch_stages",
]
