"""Cases of a blind benchmark: one after another in this process, or on the workers of a Dask scheduler.

Workers need this folder under the same path, and the same versions as a data set's (docs/how-to/data-set.md). A worker
may end or join; the rows are those of one process, in the order of their ends.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError

__all__ = ["add_scheduler", "answer", "answers"]

#: Held by the case that a worker computes: its threads take turns.
_ONE_AT_A_TIME = threading.Lock()


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--scheduler``."""
    parser.add_argument("--scheduler", help="address of a Dask scheduler whose workers share the cases")


def answers(
    module: str, cases: Sequence[Any], run: Callable[..., Any], arguments: tuple[Any, ...], scheduler: str | None
) -> Iterator[tuple[Any, Any]]:
    """Cases with the rows of their captures, in the order of their ends.

    module : name of the benchmark's module. run : its function ``run`` of a case and further arguments.
    """
    if scheduler is None:
        yield from ((case, run(case, *arguments)) for case in cases)
        return
    from cboxlab.validation.dataset import FolderTask, on_scheduler, run_from_folder

    folder = str(Path(__file__).resolve().parent)
    tasks = [
        FolderTask(folder, __name__, "answer", (module, number, asdict(case), arguments))
        for number, case in enumerate(cases)
    ]
    try:
        for number, row in on_scheduler(tasks, scheduler, lambda: None, run_from_folder):
            yield cases[number], row
    except InputError as fault:
        print(f"error: --{fault}", file=sys.stderr)
        sys.exit(2)


def answer(module: str, number: int, fields: dict[str, Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    """Number and row of a case of a benchmark's module, with the fields of its class ``Case``."""
    benchmark = importlib.import_module(module)
    with _ONE_AT_A_TIME:
        return number, benchmark.run(benchmark.Case(**fields), *arguments)
