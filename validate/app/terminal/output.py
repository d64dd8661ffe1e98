"""Results go to standard output, progress and messages to standard error; how much of both is printed."""

from __future__ import annotations

import codecs
import io
import json
import math
import os
import shlex
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.utils.files import replacing
from cboxlab.utils.table import Table as TextTable
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

__all__ = [
    "STANDARD_OUTPUT",
    "Run",
    "console",
    "data_table",
    "errors",
    "give_json",
    "print_result",
    "print_table",
    "say",
    "show_results_apart",
    "this_run",
]


class _Output(Console):
    """Standard output; a command goes on, without printing, when the reader of its output has gone (``| head``)."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


#: Without markup and emoji codes, since the output contains names given by users.
console = _Output(markup=False, emoji=False)
#: Progress and messages go to standard error, so that standard output contains only results.
errors = Console(stderr=True, markup=False, emoji=False)

#: For terminals and pipes that cannot hold these signs (an ASCII or Latin-1 locale).
_SPELLED = {
    "²": "^2",
    "³": "^3",
    "⁻": "^-",
    "±": "+-",
    "−": "-",
    "–": "-",
    "×": "x",
    "≥": ">=",
    "≤": "<=",
    "•": "*",
    "°": " deg",
    "χ": "chi",
    "σ": "sigma",
    "Δ": "Delta",
    "ρ": "rho",
    "μ": "u",
    "µ": "u",
    "Σ": "sum",
    "·": "*",
}


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """The handler of signs that an encoding lacks: spelled out, without accents, or a question mark."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    plain = (_SPELLED.get(c) or unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() for c in lacking)
    return "".join(text or "?" for text in plain), error.end


codecs.register_error("cboxlab-spelled", _spelled)

#: The file name of ``--json`` that stands for standard output.
STANDARD_OUTPUT = Path("-")


@dataclass
class Run:
    """The command that is run, and how much it prints.

    command : as typed. quiet : nothing but errors. verbose : also what each stage took, and
    the trace of a fault of the program.
    """

    quiet: bool = False
    verbose: bool = False
    command: str = "cbox"

    def begin(self, arguments: Sequence[str]) -> None:
        """The state before any option is read: results to standard output, neither quiet nor verbose."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="cboxlab-spelled")
        self.command = shlex.join(["cbox", *arguments])
        self.quiet = self.verbose = console.quiet = console.stderr = False

    def be_quiet(self) -> None:
        """Print no results and no progress; errors are printed all the same."""
        self.quiet = console.quiet = True


#: Of this process: one command is run at a time.
this_run = Run()


def show_results_apart() -> None:
    """Print results to standard error, where standard output is to hold JSON alone."""
    console.stderr = True


def say(text: str) -> None:
    """Print one line of plain text, without wrapping and without markup."""
    console.print(Text(text), soft_wrap=True)


def data_table(title: str, *header: str) -> Table:
    """A table whose first column is text, which may be wrapped, and whose others are numbers. See ``print_table``."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index else "left", no_wrap=index > 0, overflow="fold")
    return table


def print_table(table: Table) -> None:
    """Print a table; numbers that do not fit side by side in parts below each other, each with the first column."""
    first, *others = table.columns
    room = console.width - min(_width(first), console.width // 3)
    parts: list[list[Column]] = [[first]]
    for column in others:
        if len(parts[-1]) > 1 and sum(map(_width, [*parts[-1][1:], column])) > room:
            parts.append([first])
        parts[-1].append(column)
    for index, part in enumerate(parts):
        shown = data_table("" if index else str(table.title), *(str(column.header) for column in part))
        for own, column in zip(shown.columns, part, strict=True):
            own.no_wrap = column.no_wrap
        for row in zip(*(column.cells for column in part), strict=True):
            shown.add_row(*row)
        console.print(shown)


def print_result(lines: Iterable[str], tables: Iterable[TextTable]) -> None:
    """Print the sentences and tables of a result, the first sentence in bold.

    Parameters
    ----------
    lines
        Sentences, the finding first.
    tables
        Tables below them.
    """
    for index, line in enumerate(lines):
        console.print(Text(line, style="" if index else "bold"), soft_wrap=True)
    for table in tables:
        columns = data_table(table.title, *table.columns)
        for index in table.text_columns:
            columns.columns[index].no_wrap = False
        for row in table.rows:
            columns.add_row(*row)
        print_table(columns)


def _width(column: Column) -> int:
    """Signs that a column takes, with the space beside it; of one that may be wrapped its longest word's."""
    cells = [str(cell) for cell in (column.header, *column.cells)]
    words = cells if column.no_wrap else [word for cell in cells for word in cell.split()]
    return 2 + max(map(cell_len, words), default=0)


def give_json(path: Path | None, record: Mapping[str, Any]) -> None:
    """Write what was found as JSON: to a file, complete or not at all; to standard output for "-"; nowhere for None.

    record : numbers, strings, lists, dicts and paths; a number that is not finite becomes null.
    """
    if path is None:
        return
    printed = path == STANDARD_OUTPUT
    text = json.dumps(_plain(record), indent=1, allow_nan=False, ensure_ascii=printed) + "\n"
    if printed:
        print(text, end="")
        return
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
