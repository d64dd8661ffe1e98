"""Faults of a manifest as InputErrors: which key, what was found, what is expected, how to correct it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import expectation, shown
from cboxlab.utils.input_files import parse_toml, read_text
from pydantic import BaseModel, ValidationError

from .manifest import Manifest, example_of

__all__ = ["nearest", "raise_faults", "read_manifest"]


_MOST_LINES = 20


def nearest(word: str, known: Iterable[str]) -> str:
    """A hint with the known word most similar to ``word``; empty if none is similar."""
    close = difflib.get_close_matches(word, list(known), 1)
    return f"Did you mean '{close[0]}'?" if close else ""


def raise_faults(path: Path, faults: Sequence[InputError]) -> None:
    """Raise one InputError with a line for each fault; with one fault, that fault; with none, nothing."""
    if len(faults) == 1:
        raise faults[0]
    if faults:
        lines = "".join(f"\n  {fault}" for fault in faults[:_MOST_LINES])
        if len(faults) > _MOST_LINES:
            lines += f"\n  and {len(faults) - _MOST_LINES} more"
        raise InputError(path, f"{len(faults)} faults", "no faults", f"They are:{lines}")


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models(argument)]


def _table_at(location: Sequence[int | str]) -> type[BaseModel]:
    """The model of the table at a location."""
    model: type[BaseModel] = Manifest
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            inner = _models(model.model_fields[part].annotation)
            model = inner[0] if inner else model
    return model


def _key(data: Mapping[str, Any], location: Sequence[int | str]) -> str:
    text, value = "", data
    for part in location:
        if isinstance(part, str) and part.startswith("<"):
            continue
        try:
            value = value[part]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            value = {}
        if isinstance(part, int):
            identity = value.get("id", value.get("band")) if isinstance(value, Mapping) else None
            text += f"[{part}]" + (f" ({identity})" if identity and isinstance(identity, str) else "")
        else:
            text += f".{part}" if text else part
    return text


def _fault(path: Path, data: Mapping[str, Any], error: Mapping[str, Any]) -> InputError:
    location = error["loc"]
    where = f"{path}: {_key(data, location)}"
    if error["type"] == "missing":
        example = example_of(_table_at(location[:-1]), str(location[-1]))
        return InputError(where, "nothing", "this key", f"Add it, such as {example}" if example else "Add it.")
    if error["type"] == "extra_forbidden":
        known = list(_table_at(location[:-1]).model_fields)
        return InputError(where, "an unknown key", f"one of {', '.join(known)}", nearest(str(location[-1]), known))
    return InputError(where, shown(error["input"]), expectation(error))


def _without_misspelt(failure: ValidationError) -> list[Mapping[str, Any]]:
    """The errors without those of a missing key for which a misspelt key was found."""
    errors: list[Mapping[str, Any]] = [dict(error) for error in failure.errors()]
    unknown = [error["loc"] for error in errors if error["type"] == "extra_forbidden"]

    def misspelt(error: Mapping[str, Any]) -> bool:
        location = error["loc"]
        return error["type"] == "missing" and any(
            other[:-1] == location[:-1] and difflib.get_close_matches(str(other[-1]), [str(location[-1])])
            for other in unknown
        )

    return [error for error in errors if not misspelt(error)]


def read_manifest(path: Path) -> Manifest:
    """The manifest in the TOML file ``path``, its keys and their ranges checked.

    Raises one InputError that lists every faulty key. The files that it names are not read.
    """
    expected = "the manifest of a capture in TOML"
    text = read_text(path, expected, "A capture is a folder with a capture.toml in it.")
    try:
        data = parse_toml(path, text, expected)
    except InputError:
        for key, state in (("dark", "subtracted"), ("flat", "divided")):
            if re.search(rf"(?m)^\s*{key}\s*=", text) and re.search(rf"(?m)^\s*\[\[\s*{key}\s*\]\]", text):
                raise InputError(
                    f"{path}: {key}",
                    f"both {key} = ... and [[{key}]]",
                    "one of them",
                    f"Frames with {key} = '{state}' have no [[{key}]].",
                ) from None
        raise
    try:
        return Manifest.model_validate(data)
    except ValidationError as failure:
        raise_faults(path, [_fault(path, data, error) for error in _without_misspelt(failure)])
        raise AssertionError("a validation error without errors") from None
