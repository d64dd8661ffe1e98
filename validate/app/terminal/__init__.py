"""Terminal of all commands: output, stages of a computation, JSON, common options."""

from .command_line import JsonOption, command_line
from .destinations import require_file, require_folder
from .number_options import require_option_numbers
from .output import STANDARD_OUTPUT, console, data_table, errors, give_json, print_result, print_table, say, this_run
from .stages import Stages, time_text, watch_stages

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
    "require_file",
    "require_folder",
    "require_option_numbers",
    "say",
    "this_run",
    "time_text",
    "watch_stages",
]
