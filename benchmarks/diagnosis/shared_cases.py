"""Cases of a blind benchmark: one after another in this process, or on the workers of a Dask scheduler.

Workers need this folder under the same path, and the same versions as a data set's (docs/how-to/data-set.md). A worker
may end or join; the rows are those of one process, in the order of their ends.
"""

from __future__ import annotations

import argparse
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
    import cloudpickle
    from cboxlab.validation.dataset import on_scheduler

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    folder = str(Path(__file__).resolve().parent)
    tasks = [(folder, module, number, asdict(case), arguments) for number, case in enumerate(cases)]
    try:
        for number, row in on_scheduler(tasks, scheduler, lambda: None, _on_worker):
            yield cases[number], row
    except InputError as fault:
        print(f"error: --{fault}", file=sys.stderr)
        sys.exit(2)


def _on_worker(task: tuple[str, str, int, dict[str, Any], tuple[Any, ...]]) -> tuple[int, Any]:
    """Number and row of a case, in a process that may not know this module yet."""
    import importlib
    import sys

    folder, module, number, fields, arguments = task
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return number, importlib.import_module("shared_cases").answer(module, fields, arguments)


def answer(module: str, fields: dict[str, Any], arguments: tuple[Any, ...]) -> Any:
    """Row of a case of a benchmark's module, with the fields of its class ``Case``."""
    import importlib

    benchmark = importlib.import_module(module)
    with _ONE_AT_A_TIME:
        return benchmark.run(benchmark.Case(**fields), *arguments)
