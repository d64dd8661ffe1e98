"""Faults of a manifest as InputErrors: key, value, expectation and correction."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any, get_args

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import LIST_OF_FAULTS, expectation, suggestion, value_text
from cboxlab.utils.input_files import parse_toml, read_text
from pydantic import BaseModel, ValidationError

from .file_facts import with_file_facts
from .manifest import example_of
from .whole_manifest import Manifest

__all__ = ["checked_keys", "raise_faults", "read_manifest"]


#: Hint for a folder without a manifest.
_NO_MANIFEST = "A capture is a folder with a capture.toml in it. The manual's 'A first manifest' says how to begin."
#: Faults listed in one message: more would hide the first ones.
_MAX_FAULTS_LISTED = 20


#: Fewest further faults of the same text that are stated as one.
_FEWEST_ALIKE = 3


def raise_faults(path: Path, faults: Sequence[InputError]) -> None:
    """Raise one InputError for all faults; nothing for none.

    With one fault, that fault is raised. With several, one error with a line for each.

    Parameters
    ----------
    path
        The faulty file.
    faults
        Its faults.
    """
    faults = _alike_as_one(faults)
    if len(faults) == 1:
        raise faults[0]
    if faults:
        lines = "".join(f"\n  {fault}" for fault in faults[:_MAX_FAULTS_LISTED])
        if len(faults) > _MAX_FAULTS_LISTED:
            lines += f"\n  and {len(faults) - _MAX_FAULTS_LISTED} more"
        raise InputError(path, f"{len(faults)} faults", "no faults", f"{LIST_OF_FAULTS}{lines}")


def _alike_as_one(faults: Sequence[InputError]) -> list[InputError]:
    """Faults, many of the same text as one: a wrong width is a fault of every frame."""
    groups: dict[tuple[str, str, str], list[InputError]] = {}
    for fault in faults:
        groups.setdefault((fault.found, fault.expected, fault.hint), []).append(fault)
    return [
        part
        for (fault, *others) in groups.values()
        for part in (
            [InputError(f"{fault.where} and {len(others)} others", fault.found, fault.expected, fault.hint)]
            if len(others) >= _FEWEST_ALIKE
            else [fault, *others]
        )
    ]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Tables in a type annotation."""
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
    """Key at a location with the identifier of its table: ``band[0] (f550).exposure_s``."""
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
    """One error of pydantic as InputError, with an example or the nearest key."""
    location = error["loc"]
    where = f"{path}: {_key(data, location)}"
    if error["type"] == "missing" and isinstance(location[-1], int):
        count = len(error["input"])
        return InputError(f"{path}: {_key(data, location[:-1])}", f"a list of {count}", f"at least {location[-1] + 1}")
    if error["type"] == "missing":
        example = example_of(_table_at(location[:-1]), str(location[-1]))
        return InputError(where, "nothing", "this key", f"Add it, such as {example}" if example else "Add it.")
    if error["type"] == "extra_forbidden":
        keys = list(_table_at(location[:-1]).model_fields)
        return InputError(where, "an unknown key", f"one of {', '.join(keys)}", suggestion(str(location[-1]), keys))
    is_unit = isinstance(error["input"], str) and re.fullmatch(r"[\d.,]+\s*[a-zµ%]+", error["input"].strip())
    hint = "Write the number alone, without quotation marks: its unit is that of the key." if is_unit else ""
    if isinstance(error["input"], date | time) and location[-1] == "start_s":
        hint = "State the seconds since the capture's first frame, such as 0.0 and 60.0."
    return InputError(where, value_text(error["input"]), expectation(error), hint)


def _without_misspelt(failure: ValidationError) -> list[Mapping[str, Any]]:
    """The errors without those of misspelt keys and without copies of [defaults]."""
    errors: list[Mapping[str, Any]] = [dict(error) for error in failure.errors()]
    unknown = [error["loc"] for error in errors if error["type"] == "extra_forbidden"]

    def misspelt(error: Mapping[str, Any]) -> bool:
        location = error["loc"]
        return error["type"] == "missing" and any(
            other[:-1] == location[:-1] and difflib.get_close_matches(str(other[-1]), [str(location[-1])])
            for other in unknown
        )

    def is_default(error: Mapping[str, Any]) -> bool:
        """Whether the faulty value stands in [defaults], whose own fault is enough."""
        location = error["loc"]
        return location[0] != "defaults" and any(
            other["loc"][:2] == ("defaults", location[-1]) and other["input"] == error["input"] for other in errors
        )

    return [error for error in errors if not misspelt(error) and not is_default(error)]


def read_manifest(path: Path) -> Manifest:
    """Read a manifest and check its keys and their ranges.

    Of the files that it names, headers alone are read: they state what the manifest leaves out.

    Parameters
    ----------
    path
        The TOML file.

    Returns
    -------
    Manifest
        Its content.

    Raises
    ------
    InputError
        One error that lists every faulty key.
    """
    expected = "the manifest of a capture in TOML"
    text = read_text(path, expected, _NO_MANIFEST)
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
    manifest, faults = checked_keys(path, data)
    raise_faults(path, faults)
    if manifest is None:
        raise AssertionError("a validation error without errors")
    return manifest


def checked_keys(path: Path, data: dict[str, Any]) -> tuple[Manifest | None, list[InputError]]:
    """The manifest of parsed TOML, or the faults of its keys.

    Parameters
    ----------
    path
        The TOML file.
    data
        Its content.

    Returns
    -------
    tuple
        Manifest, or None with at least one fault.
    """
    data = with_file_facts(path.parent, data)
    try:
        return Manifest.model_validate(data), []
    except ValidationError as failure:
        return None, [_fault(path, data, error) for error in _without_misspelt(failure)]
