"""Common functions of commands: output, progress, folders for results, parsing of numbers."""

from __future__ import annotations

import math
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cboxlab.utils.errors import InputError
from cboxlab.utils.numbers import number_of
from cboxlab.utils.progress import ProgressReporter
from rich.text import Text

from ..terminal import (
    console,
    data_table,
    errors,
    give_json,
    print_result,
    print_table,
    require_file,
    require_folder,
    say,
    this_run,
    watch_stages,
)

if TYPE_CHECKING:
    import numpy as np
    from cboxlab.calibration.capture import Capture
    from cboxlab.rendering.files import Declared, DeclaredPair
    from cboxlab.rendering.model import Model
    from numpy.typing import NDArray

__all__ = [
    "bar",
    "choose_device",
    "console",
    "data_table",
    "declared_files",
    "declared_pair",
    "errors",
    "give_json",
    "load_inputs",
    "options",
    "positive_number",
    "print_result",
    "print_table",
    "require_file",
    "require_folder",
    "say",
    "this_run",
    "warn_unless_compiled",
    "wavelengths",
]


def declared_files(declare: list[str] | None) -> Declared:
    """Values of --declare.

    Parameters
    ----------
    declare
        Texts KEY=VALUE; None for none.

    Returns
    -------
    Declared
        The values.

    Raises
    ------
    InputError
        For an unknown key, a repeated key, and a value without meaning.
    """
    return declared_pair(declare, ()).both


def declared_pair(declare: list[str] | None, sides: tuple[str, str] | tuple[()]) -> DeclaredPair:
    """Values of --declare for two files.

    Parameters
    ----------
    declare
        Texts KEY=VALUE for both files, or SIDE:KEY=VALUE for one; None for none.
    sides
        Names of the files; empty for a command with one file.

    Returns
    -------
    DeclaredPair
        The values.

    Raises
    ------
    InputError
        As of ``declared_files``, and for a scale whose unit is not declared.
    """
    from cboxlab.rendering.files import DECLARABLE, DeclaredPair

    keys = f"{', '.join(DECLARABLE)}" + (f", and {' or '.join(f'{s}:' for s in sides)} before it" if sides else "")
    values: dict[str, dict[str, str]] = {name: {} for name in ("", *sides)}
    for text in declare or ():
        start, equals, value = (part.strip() for part in text.partition("="))
        side, _, key = (part.strip() for part in start.rpartition(":"))
        declared = values.get(side, {})
        if not equals or not value or key not in DECLARABLE or key in declared or side not in values:
            raise InputError("--declare", repr(text), f"KEY=VALUE, each once, with {keys}")
        declared[key] = value
    for declared in [{**values[""], **values[side]} for side in sides] or [values[""]]:
        if "scale" in declared and "units" not in declared:
            raise InputError("--declare", "scale without units", "scale and the units of the scaled values")
    first, second = sides or ("", "")
    pair = DeclaredPair((first, second), _declared(values[""]))
    return replace(pair, by_file=(_declared(values[first]), _declared(values[second]))) if sides else pair


def _declared(values: dict[str, str]) -> Declared:
    """Checked values of one file."""
    from cboxlab.rendering.files import Declared

    scale = positive_number(values["scale"], "--declare scale") if "scale" in values else None
    at = _listed_wavelengths(values["wavelengths"]) if "wavelengths" in values else None
    texts = (values.get(key) for key in ("colour-space", "wavelength-unit", "layer"))
    return Declared(values.get("units"), scale, at, *texts)


@contextmanager
def bar(title: str) -> Iterator[ProgressReporter]:
    """Show the stages of a computation as ``watch_stages`` does.

    Ctrl-C stops the computation at its next step, a second Ctrl-C immediately.

    Parameters
    ----------
    title
        Name of the stage until the first report.

    Yields
    ------
    ProgressReporter
        Receiver of the computation's progress.
    """
    with watch_stages(title) as report:
        progress = ProgressReporter(report)
        with _interrupt_cancels(progress):
            yield progress


@contextmanager
def _interrupt_cancels(progress: ProgressReporter) -> Iterator[None]:
    """Cancel a computation at the first Ctrl-C in the context."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, before)
        progress.cancel()
        errors.print("Stopping at the next step. Press Ctrl-C again to stop immediately.")

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def options(hint: str = "", **names: str) -> Iterator[None]:
    """Rename arguments in the library's errors to the options of the command.

    Parameters
    ----------
    hint
        Hint for errors without one.
    **names
        Option by argument, such as ``effects="--effects"``.

    Raises
    ------
    InputError
        The library's error, with the renamed argument.
    """
    try:
        yield
    except InputError as error:
        where = names.get(error.where, re.sub("^declared (?=[A-Za-z:-]+$)", "--declare ", error.where))
        # the library's messages call the option "declare KEY=VALUE"
        text = re.sub(r"(^|; |: |, or |are )declare (?=[a-z-]+=)", r"\1--declare ", error.hint or hint)
        raise InputError(where, error.found, error.expected, text) from None


def choose_device(name: str | None) -> None:
    """Choose the device that renders in this process.

    Parameters
    ----------
    name
        "cpu" or "cuda"; None changes nothing.

    Raises
    ------
    InputError
        For another name, or if there is no GPU.
    """
    if name is None:
        return
    if name not in ("cpu", "cuda"):
        raise InputError("--device", f"'{name}'", "cpu or cuda")
    from cboxlab.rendering.device import variant

    if variant.use(name).split("_")[0] != "cuda" and name == "cuda":
        raise InputError("--device", "no GPU that Mitsuba can use", "cpu, or a machine with a CUDA GPU")


def load_inputs(model: Path | None, folders: Sequence[Path]) -> tuple[Model, tuple[Capture, ...]]:
    """Model and captures of a command.

    Parameters
    ----------
    model
        File of --model. None for the box that the captures state, or the published box.
    folders
        Folders of the captures.

    Returns
    -------
    model
        The model.
    captures
        The captures.

    Raises
    ------
    InputError
        If an input is faulty.
    """
    from cboxlab.calibration.capture import load_capture

    from ...api import as_model

    captures = tuple(load_capture(folder) for folder in folders)
    result = as_model(model, captures)
    for capture in captures if model is None else ():
        scene = capture.manifest.scene
        if scene is not None and capture.scene_reference is None and result.scene.origin is not None:
            manifest, name = capture.folder / "capture.toml", result.scene.origin.reference
            errors.print(
                Text(f'{manifest}: scene is "{scene}", but the model is "{name}". Give the box with --model.'),
                soft_wrap=True,
            )
    return result, captures


def warn_unless_compiled() -> None:
    """Print a warning if no compiled variant is available, since rendering is then slow."""
    from cboxlab.rendering.device import variant

    if not variant.compiled():
        errors.print(Text(variant.HINT))


def positive_number(text: str, option: str) -> float:
    """Number above 0 of an option.

    Parameters
    ----------
    text
        Text such as 0.003, 0.3% or 1/300.
    option
        Name of the option, for the message.

    Returns
    -------
    float
        The number.

    Raises
    ------
    InputError
        For any other text.
    """
    try:
        percent = text.strip().endswith("%")
        over, _, under = text.strip().removesuffix("%").partition("/")
        value = number_of(over) / (number_of(under) if "/" in text else 1.0) / (100 if percent else 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        value = float("nan")
    if not (math.isfinite(value) and value > 0):
        raise InputError(option, repr(text), "a number above 0, such as 0.003, 0.3% or 1/300")
    return value


def _listed_wavelengths(text: str) -> tuple[float, ...]:
    """Wavelengths of a file, as ``wavelengths`` reads them; a list may have any order."""
    listed = [number_of(part) for part in text.split(",")] if ":" not in text else []
    usable = bool(listed) and all(map(math.isfinite, listed))
    ascending = wavelengths(",".join(map(repr, sorted(listed))) if usable else text, "--declare wavelengths")
    return tuple(listed) if usable else tuple(ascending.tolist())


def wavelengths(text: str, option: str = "--wavelengths") -> NDArray[np.float64]:
    """Wavelengths of an option.

    Parameters
    ----------
    text
        "first:last:step", both ends included, or a list such as "450,550,650", nm.
    option
        Name of the option, for the message.

    Returns
    -------
    NDArray
        (w,) ascending wavelengths, nm.

    Raises
    ------
    InputError
        For any other text, and for more than 2000 wavelengths.
    """
    import numpy as np

    expected = "first:last:step such as 400:700:10, or a list such as 450,550,650, ascending, in nm"
    try:
        if ":" in text:
            first, last, step = (number_of(part) for part in text.split(":"))
            count = (last - first) / step
            if not 0 <= count < 2000:
                raise ValueError
            values = first + step * np.arange(int(count + 1e-9) + 1)
        else:
            values = np.array([number_of(part) for part in text.split(",")])
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(option, repr(text), expected) from None
    if not np.all(np.isfinite(values)) or values[0] <= 0 or np.any(np.diff(values) <= 0) or values.size > 2000:
        raise InputError(option, repr(text), expected)
    return np.asarray(values, np.float64)
