"""Output of commands: results to standard output, progress and messages to standard error."""

from __future__ import annotations

import codecs
import io
import json
import logging
import os
import shlex
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.utils.files import replacing
from cboxlab.utils.numbers import json_value
from cboxlab.utils.table import Table as TextTable
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

__all__ = [
    "STANDARD_OUTPUT",
    "RunningCommand",
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
    """Standard output; if its reader ends (``| head``), a command continues without printing."""

    def on_broken_pipe(self) -> None:
        """Print nothing more."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


#: Standard output, without markup and emoji codes, since the output contains names given by users.
console = _Output(markup=False, emoji=False)
#: Standard error, for progress and messages, so that standard output contains only results.
errors = Console(stderr=True, markup=False, emoji=False)

#: Replacements of signs that an encoding lacks, such as ASCII or Latin-1.
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
    """Replacement of signs that an encoding lacks, and position after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    plain = (_SPELLED.get(c) or unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() for c in lacking)
    return "".join(text or "?" for text in plain), error.end


codecs.register_error("cboxlab-spelled", _spelled)

#: The file name of ``--json`` that stands for standard output.
STANDARD_OUTPUT = Path("-")


class _LogLines(logging.Handler):
    """Lines of the library's log on standard error, above a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a line while the running command is verbose."""
        if this_run.verbose and not this_run.quiet:
            errors.print(Text(f"{record.name.removeprefix('cboxlab.')}: {record.getMessage()}"), soft_wrap=True)


@dataclass
class RunningCommand:
    """The running command and the amount that it prints."""

    #: Whether only errors are printed.
    quiet: bool = False
    #: Whether the duration of each stage and the trace of a program error are printed.
    verbose: bool = False
    #: Command as typed.
    command: str = "cbox"

    def begin(self, arguments: Sequence[str]) -> None:
        """Reset to the state before any option is read: neither quiet nor verbose.

        Parameters
        ----------
        arguments
            Arguments of the command.
        """
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="cboxlab-spelled")
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns of a home that cannot be written
        self.command = shlex.join(["cbox", *arguments])
        self.quiet = self.verbose = console.quiet = console.stderr = False

    def be_verbose(self) -> None:
        """Print what the library logs, and the duration of each stage."""
        self.verbose = True
        logger = logging.getLogger("cboxlab")
        if not any(isinstance(handler, _LogLines) for handler in logger.handlers):
            logger.addHandler(_LogLines())
        logger.setLevel(logging.INFO)

    def be_quiet(self) -> None:
        """Print errors only."""
        self.quiet = console.quiet = True


#: Run of this process, which runs one command at a time.
this_run = RunningCommand()


def show_results_apart() -> None:
    """Print results to standard error, so that standard output contains only JSON."""
    console.stderr = True


def say(text: str) -> None:
    """Print one line of plain text, without wrapping and without markup.

    Parameters
    ----------
    text
        The line.
    """
    console.print(Text(text), soft_wrap=True)


def data_table(title: str, *header: str) -> Table:
    """Empty table for ``print_table``.

    Parameters
    ----------
    title
        Title above the table.
    *header
        Headers of the columns. The first column is text, which may be wrapped; the others are numbers.

    Returns
    -------
    Table
        Table without rows.
    """
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index else "left", no_wrap=index > 0, overflow="fold")
    return table


def print_table(table: Table) -> None:
    """Print a table; columns that do not fit follow below, each part with the first column.

    Parameters
    ----------
    table
        A table of ``data_table``.
    """
    first, *others = table.columns
    room = console.width - min(_width(first), console.width // 3)
    parts: list[list[Column]] = [[first]]
    for column in others:
        if len(parts[-1]) > 1 and sum(map(_width, [*parts[-1][1:], column])) > room:
            parts.append([first])
        parts[-1].append(column)
    for index, part in enumerate(parts):
        part_table = data_table("" if index else str(table.title), *(str(column.header) for column in part))
        for copy, column in zip(part_table.columns, part, strict=True):
            copy.no_wrap = column.no_wrap
        for row in zip(*(column.cells for column in part), strict=True):
            part_table.add_row(*row)
        console.print(part_table)


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
    """Number of signs of a column with its margin; of a wrapped column, of its longest word."""
    cells = [str(cell) for cell in (column.header, *column.cells)]
    parts = cells if column.no_wrap else [word for cell in cells for word in cell.split()]
    return 2 + max(map(cell_len, parts), default=0)


def give_json(path: Path | None, record: Mapping[str, Any]) -> None:
    """Write results as JSON.

    Parameters
    ----------
    path
        File, which is written completely or not at all; "-" for standard output; None writes nothing.
    record
        Numbers, strings, lists, dicts and paths. A number that is not finite becomes null.
    """
    if path is None:
        return
    printed = path == STANDARD_OUTPUT
    text = json.dumps(json_value(record), indent=1, allow_nan=False, ensure_ascii=printed) + "\n"
    if printed:
        print(text, end="")
        return
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
