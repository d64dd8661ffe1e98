"""InputErrors for input files: several faults in one, validation errors, paths, similar names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from .errors import InputError

__all__ = [
    "combined",
    "expectation",
    "faults_of_validation",
    "path_inside",
    "referred",
    "shown",
    "suggestion",
]


#: Errors of pydantic whose own words speak of its types, and what they ask for. key : the faulty key.
_LIST_TYPES, _TABLE_TYPES = ("tuple_type", "list_type"), ("model_type", "dict_type")
_PLAIN = {
    "tuple_type": "a list in brackets, {key} = [...]",
    "list_type": "a list in brackets, {key} = [...]",
    "too_short": "a list of at least {min_length}",
    "model_type": "one table, [{key}]",
    "dict_type": "one table, [{key}]",
    "string_type": "text in quotes",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
}

#: A part of a name that is shorter says nothing.
_SHORTEST_PART = 4


def combined(faults: Sequence[InputError]) -> InputError:
    """One InputError for all ``faults`` (at least one): the first in full, the others listed in its hint."""
    first, others = faults[0], faults[1:]
    if not others:
        return first
    more = "; ".join(f"({number}) {fault}" for number, fault in enumerate(others, start=2))
    hint = f"{first.hint}. " if first.hint else ""
    return InputError(first.where, first.found, first.expected, f"{hint}{len(others)} more: {more}")


def referred(fault: InputError, where: str) -> InputError:
    """The fault of another file, reported at ``where``, the key that refers to that file."""
    return InputError(where, f"{fault.found} ({fault.where})", fault.expected, fault.hint)


def suggestion(name: str, known: Iterable[str]) -> str:
    """``"did you mean 'x'?"`` for the most similar known name, else for the only one that contains it; or empty."""
    names = list(known)
    containing = [other for other in names if len(name) >= _SHORTEST_PART and name in other]
    near = difflib.get_close_matches(name, names, n=1) or (containing if len(containing) == 1 else [])
    return f"did you mean '{near[0]}'?" if near else ""


def path_inside(folder: Path, name: str, where: str | Path) -> Path:
    """The path of a file named relative to ``folder``, links resolved.

    Raises InputError (at ``where``) for an absolute path and for one that leaves the folder.
    """
    expected = "a path inside the folder, relative to it, with forward slashes"
    if not name or "\0" in name or "\\" in name or PurePosixPath(name).is_absolute():
        raise InputError(where, repr(name), expected)
    try:
        path = (folder / name).resolve()
        inside = path.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(where, f"{name!r} ({error})", expected) from None
    if not inside:
        raise InputError(where, f"{name!r}, which leaves the folder", expected)
    return path


def faults_of_validation(path: Path, error: ValidationError, model: type[BaseModel]) -> list[InputError]:
    """One InputError for each error that pydantic found in the file at ``path`` when read as ``model``.

    Keys are written like ``surface[2].material``. For an unknown key, the allowed keys and the most similar one
    are given.
    """
    return [_fault(path, dict(details), model) for details in error.errors(include_url=False)]


def _fault(path: Path, details: dict[str, Any], model: type[BaseModel]) -> InputError:
    location: tuple[int | str, ...] = details["loc"]
    where = f"{path}: {_key(location)}" if location else str(path)
    kind, value = details["type"], details["input"]
    if kind == "extra_forbidden":
        known = sorted(_keys_at(model, location[:-1]))
        hint = suggestion(str(location[-1]), known)
        return InputError(where, "an unknown key", f"one of {', '.join(known)}", hint)
    if kind == "missing":
        return InputError(where, "nothing", "a value: this key is required")
    return InputError(where, shown(value), expectation(details))


def expectation(details: Mapping[str, Any]) -> str:
    """What an error that pydantic found asks for, in words for the file's author."""
    key = next((part for part in reversed(details["loc"]) if isinstance(part, str) and not part.startswith("<")), "")
    in_list = bool(details["loc"]) and isinstance(details["loc"][-1], int)
    one_for_many = details["type"] in _LIST_TYPES and isinstance(details["input"], Mapping)
    if one_for_many or (in_list and details["type"] in _TABLE_TYPES):
        return f"tables in double brackets, [[{key}]]"
    if (plain := _PLAIN.get(details["type"])) is not None:
        return plain.format(key=key, **details.get("ctx", {}))
    return str(details["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")


def shown(value: object) -> str:
    """A value of a file in at most 80 characters, of a table its keys."""
    keys = ", ".join(map(str, value)) if isinstance(value, dict) else ""
    text = f"a table with the keys {keys}" if keys else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _key(location: tuple[int | str, ...]) -> str:
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).removeprefix(".")


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> set[str]:
    """The keys that the table at ``location`` may have."""
    current = model
    for part in location:
        field = next((f for name, f in current.model_fields.items() if part in (name, f.alias)), None)
        if field is not None:
            current = _model_in(field.annotation) or current
    return {field.alias or name for name, field in current.model_fields.items()}


def _model_in(annotation: object) -> type[BaseModel] | None:
    """The first pydantic model inside a type such as ``list[Model] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_in(part))), None)
