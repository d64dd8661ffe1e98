"""Functions common to all commands: output, progress bars, folders for results, parsing of numbers."""

from __future__ import annotations

import math
import os
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import ProgressReporter
from rich.text import Text

from ..terminal import (
    console,
    data_table,
    errors,
    give_json,
    print_result,
    print_table,
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
    "require_folder",
    "say",
    "this_run",
    "warn_unless_compiled",
    "wavelengths",
]


def declared_files(declare: list[str] | None) -> Declared:
    """The values of --declare. Raises InputError for an unknown key, a key twice, and a value without meaning."""
    return declared_pair(declare, ()).both


def declared_pair(declare: list[str] | None, sides: tuple[str, str] | tuple[()]) -> DeclaredPair:
    """The values of --declare, for both files or, as SIDE:KEY=VALUE, for one. Raises InputError as ``declared_files``,
    and for a scale whose unit is not declared.
    """
    from cboxlab.rendering.files import DECLARABLE, DeclaredPair

    keys = f"{', '.join(DECLARABLE)}" + (f", and {' or '.join(f'{s}:' for s in sides)} before it" if sides else "")
    values: dict[str, dict[str, str]] = {name: {} for name in ("", *sides)}
    for text in declare or ():
        start, equals, value = (part.strip() for part in text.partition("="))
        side, _, key = (part.strip() for part in start.rpartition(":"))
        own = values.get(side, {})
        if not equals or not value or key not in DECLARABLE or key in own or side not in values:
            raise InputError("--declare", repr(text), f"KEY=VALUE, each once, with {keys}")
        own[key] = value
    for own in [{**values[""], **values[side]} for side in sides] or [values[""]]:
        if "scale" in own and "units" not in own:
            raise InputError("--declare", "scale without units", "the unit of the scaled values beside it")
    first, second = sides or ("", "")
    pair = DeclaredPair((first, second), _declared(values[""]))
    return replace(pair, own=(_declared(values[first]), _declared(values[second]))) if sides else pair


def _declared(values: dict[str, str]) -> Declared:
    from cboxlab.rendering.files import Declared

    scale = positive_number(values["scale"], "--declare scale") if "scale" in values else None
    at = _listed_wavelengths(values["wavelengths"]) if "wavelengths" in values else None
    return Declared(values.get("units"), scale, at, values.get("colour-space"), values.get("wavelength-unit"))


@contextmanager
def bar(title: str) -> Iterator[ProgressReporter]:
    """The stages of a computation, as ``watch_stages`` shows them.

    Ctrl-C stops the computation at its next step, a second Ctrl-C immediately.
    """
    with watch_stages(title) as report:
        progress = ProgressReporter(report)
        with _interrupt_cancels(progress):
            yield progress


@contextmanager
def _interrupt_cancels(progress: ProgressReporter) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # signals come to the main thread alone
        return

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, before)
        progress.cancel()
        errors.print("stopping; Ctrl-C again stops at once")

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def options(hint: str = "", **names: str) -> Iterator[None]:
    """The library's errors name arguments: here the options of that name, ``effects="--effects"``.

    hint : of errors that have none.
    """
    try:
        yield
    except InputError as error:
        where = names.get(error.where, re.sub("^declared (?=[A-Za-z:-]+$)", "--declare ", error.where))
        # of what is declared for files, the library's messages say "declare KEY=VALUE"
        text = re.sub(r"(^|; |: |, or |are )declare (?=[a-z-]+=)", r"\1--declare ", error.hint or hint)
        raise InputError(where, error.found, error.expected, text) from None


def choose_device(name: str | None) -> None:
    """Render on "cpu" or "cuda" in this process; None changes nothing. Raises InputError for other names or no GPU."""
    if name is None:
        return
    if name not in ("cpu", "cuda"):
        raise InputError("--device", f"'{name}'", "cpu or cuda")
    from cboxlab.rendering.device import variant

    if variant.use(name).split("_")[0] != "cuda" and name == "cuda":
        raise InputError("--device", "no GPU that Mitsuba can use", "cpu, or a machine with a CUDA GPU")


def load_inputs(model: Path | None, folders: Sequence[Path]) -> tuple[Model, tuple[Capture, ...]]:
    """The model of --model and the captures; without --model the box that these state, or the published one."""
    from cboxlab.calibration.capture import load_capture

    from ...api import as_model

    captures = tuple(load_capture(folder) for folder in folders)
    result = as_model(model, captures)
    for capture in captures if model is None else ():
        stated = capture.manifest.scene
        if stated is not None and capture.scene_reference is None and result.scene.origin is not None:
            manifest, name = capture.folder / "capture.toml", result.scene.origin.reference
            errors.print(
                Text(f'{manifest}: scene is "{stated}", the model "{name}". Give the box with --model.'), soft_wrap=True
            )
    return result, captures


def warn_unless_compiled() -> None:
    """Print a warning if no compiled variant is available, since rendering is slow then."""
    from cboxlab.rendering.device import variant

    if not variant.compiled():
        errors.print(Text(variant.HINT))


def require_folder(path: Path) -> None:
    """Raise InputError unless ``path`` is a writable folder or can be created as one."""
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(path, f"a file ({place})", "a folder for results", "Name another one with --out.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(path, f"a folder without write permission ({place})", "a writable folder")


def positive_number(text: str, option: str) -> float:
    """A number above 0, written as 0.003, 0.3% or 1/300. Raises InputError for any other text."""
    try:
        percent = text.strip().endswith("%")
        value = float(Fraction(text.strip().removesuffix("%").strip())) / (100 if percent else 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        value = float("nan")
    if not (math.isfinite(value) and value > 0):
        raise InputError(option, repr(text), "a number above 0, such as 0.003, 0.3% or 1/300")
    return value


def _listed_wavelengths(text: str) -> tuple[float, ...]:
    """As ``wavelengths``, but a list may have any order."""
    try:
        listed = sorted(float(part) for part in text.split(",")) if ":" not in text else []
    except ValueError:
        listed = []
    ascending = wavelengths(",".join(map(repr, listed)) if listed else text, "--declare wavelengths")
    return tuple(float(part) for part in text.split(",")) if listed else tuple(ascending.tolist())


def wavelengths(text: str, option: str = "--wavelengths") -> NDArray[np.float64]:
    """(w,) nm of "first:last:step" (both ends included) or of a list "450,550,650".

    Raises InputError unless they ascend and are at most 2000.
    """
    import numpy as np

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
    if not np.all(np.isfinite(values)) or values[0] <= 0 or np.any(np.diff(values) <= 0) or values.size > 2000:
        raise InputError(option, repr(text), expected)
    return np.asarray(values, np.float64)
