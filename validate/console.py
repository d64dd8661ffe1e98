"""What all commands share: terminal, progress bars, places for results, numbers as people write them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import numpy as np
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

__all__ = [
    "bar",
    "choose_device",
    "console",
    "data_table",
    "errors",
    "positive_number",
    "require_compiled",
    "require_folder",
    "say",
    "wavelengths",
]

console = Console()
#: Progress and messages go to standard error, so that standard output holds results alone.
errors = Console(stderr=True)


def say(text: str) -> None:
    """One line of plain text, not wrapped: what stands in square brackets is no markup."""
    console.print(Text(text), soft_wrap=True)


def data_table(title: str, *header: str) -> Table:
    """A table whose first column is text and whose others are numbers."""
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


@contextmanager
def bar(title: str) -> Iterator[Callable[[float], None]]:
    """A progress bar that takes the part done, 0 to 1; none where standard error is no terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as progress:
        task = progress.add_task(title, total=1.0)
        yield lambda part: progress.update(task, completed=part)


def choose_device(name: str | None) -> None:
    """Render on "cpu" or "cuda", for the rest of the process; None leaves it as it is. Raises InputError."""
    if name is None:
        return
    if name not in ("cpu", "cuda"):
        raise InputError("--device", f"'{name}'", "cpu or cuda")
    os.environ["CBOX_DEVICE"] = name
    from cboxlab.render import variant

    if variant.use(name).split("_")[0] != "cuda" and name == "cuda":
        raise InputError("--device", "no GPU that Mitsuba can use", "cuda where there is one, else cpu")


def require_compiled() -> None:
    """Say so where rendering will be slow."""
    from cboxlab.render import variant

    if not variant.compiled():
        errors.print(Text(variant.HINT))


def require_folder(path: Path) -> None:
    """Raises InputError where ``path`` is no folder that can be written to and cannot become one."""
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(path, f"a file ({place})", "a folder for results", "Name another one with --out.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(path, f"a folder that you may not write to ({place})", "a place for results")


def positive_number(text: str, option: str) -> float:
    """A number above 0, written 0.003, 0.3% or 1/300. Raises InputError otherwise."""
    try:
        percent = text.strip().endswith("%")
        value = float(Fraction(text.strip().removesuffix("%").strip())) / (100 if percent else 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        value = float("nan")
    if not (np.isfinite(value) and value > 0):
        raise InputError(option, repr(text), "a number above 0, such as 0.003, 0.3% or 1/300")
    return value


def wavelengths(text: str, option: str = "--wavelengths") -> NDArray[np.float64]:
    """(w,) nm of "first:last:step" (both ends included) or of a list "450,550,650".

    Raises InputError unless they ascend and are at most 2000.
    """
    expected = "first:last:step such as 400:700:10, or a list such as 450,550,650, ascending, in nm"
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            count = (last - first) / step
            if not 0 <= count < 2000:
                raise ValueError
            values = first + step * np.arange(int(count + 1e-9) + 1)
        else:
            values = np.array([float(part) for part in text.split(",")])
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(option, repr(text), expected) from None
    if (
        not np.all(np.isfinite(values))
        or values[0] <= 0
        or np.any(np.diff(values) <= 0)
        or values.size > 2000
    ):
        raise InputError(option, repr(text), expected)
    return np.asarray(values, np.float64)
