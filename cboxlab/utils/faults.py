"""InputErrors for input files: combined faults, faults of validation, paths, hints."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from datetime import date, time
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from .errors import InputError

__all__ = [
    "LIST_OF_FAULTS",
    "combined",
    "expectation",
    "faults_of_validation",
    "path_inside",
    "referred",
    "suggestion",
    "validated",
    "value_text",
]

Content = TypeVar("Content", bound=BaseModel)


#: Words before the lines of several faults.
LIST_OF_FAULTS = "They are:"

#: Types of pydantic's errors for a value that should be a list.
_LIST_TYPES = ("tuple_type", "list_type")
#: Types of pydantic's errors for a value that should be a table.
_TABLE_TYPES = ("model_type", "dict_type")
#: By type of pydantic's error, the value asked for; pydantic's message would speak of types of Python. `{key}` is the
#: faulty key, other names are from the context of the error.
_PLAIN = {
    "tuple_type": "a list in brackets, {key} = [...]",
    "list_type": "a list in brackets, {key} = [...]",
    "too_short": "a list or table of at least {min_length}",
    "too_long": "a list or table of at most {max_length}",
    "model_type": "one table, [{key}]",
    "model_attributes_type": "one table, [{key}]",
    "dict_type": "one table, [{key}]",
    "string_type": "text in quotes",
    "string_too_short": "text of at least {min_length} characters",
    "string_too_long": "text of at most {max_length} characters",
    "string_pattern_mismatch": "text of the pattern {pattern}",
    "literal_error": "{expected}",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of {ge} or more",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of {le} or less",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}

#: Shortest name, in characters, that is looked for inside other names: a shorter one is in too many.
_SHORTEST_PART = 4

#: Faults of a file that are described; a list of keys and the search for similar ones take time.
_MAX_FAULTS = 100


def combined(faults: Sequence[InputError]) -> InputError:
    """One InputError for several faults: the first in full, the others listed in its hint.

    Parameters
    ----------
    faults
        At least one fault.

    Returns
    -------
    InputError
        The first fault itself if it is the only one.
    """
    first, others = faults[0], faults[1:]
    if not others:
        return first
    more = "; ".join(f"({number}) {fault}" for number, fault in enumerate(others, start=2))
    hint = f"{first.hint}. " if first.hint else ""
    return InputError(first.where, first.found, first.expected, f"{hint}{len(others)} more: {more}")


def referred(fault: InputError, where: str) -> InputError:
    """The fault of another file, reported at the key that refers to that file.

    Parameters
    ----------
    fault
        Fault of the other file.
    where
        File and key that refer to it.

    Returns
    -------
    InputError
        A fault at `where`, with the place in the other file in parentheses.
    """
    return InputError(where, f"{fault.found} ({fault.where})", fault.expected, fault.hint)


def suggestion(name: str, candidates: Iterable[str]) -> str:
    """Hint at the name that was meant.

    Parameters
    ----------
    name
        A name that is not allowed.
    candidates
        The names that are.

    Returns
    -------
    str
        ``"Did you mean 'x'?"`` for the most similar candidate, else for the only one that contains the name; empty if
        there is none.
    """
    names = list(candidates)
    containing = [other for other in names if len(name) >= _SHORTEST_PART and name in other]
    near = difflib.get_close_matches(name, names, n=1) or (containing if len(containing) == 1 else [])
    return f"Did you mean '{near[0]}'?" if near else ""


def path_inside(folder: Path, name: str, where: str | Path) -> Path:
    """Path of a file in a folder, with links resolved.

    Parameters
    ----------
    folder
        The folder.
    name
        Path relative to it, with forward slashes.
    where
        File and key at which a fault is reported.

    Returns
    -------
    Path
        The absolute path; the file need not exist.

    Raises
    ------
    InputError
        For an absolute path, and for one that leaves the folder.
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


def validated(path: Path, content: object, model: type[Content]) -> Content:
    """Content of a file as its pydantic model.

    Parameters
    ----------
    path
        The file.
    content
        Its tables and values.
    model
        The model.

    Returns
    -------
    Content
        The checked content.

    Raises
    ------
    InputError
        With all faults of the file's keys.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, model)) from None


def faults_of_validation(path: Path, error: ValidationError, model: type[BaseModel]) -> list[InputError]:
    """Faults that pydantic found in a file.

    Keys are written like ``surface[2].material``. For an unknown key, the allowed keys and the most similar one are
    given.

    Parameters
    ----------
    path
        The file.
    error
        The error that pydantic raised.
    model
        The model by which it was read.

    Returns
    -------
    list[InputError]
        One fault for each error of pydantic, up to 100.
    """
    return [_fault(path, dict(details), model) for details in error.errors(include_url=False)[:_MAX_FAULTS]]


def _fault(path: Path, details: dict[str, Any], model: type[BaseModel]) -> InputError:
    """The fault of one error of pydantic, by its details."""
    location: tuple[int | str, ...] = details["loc"]
    where = f"{path}: {_key(location)}" if location else str(path)
    kind, value = details["type"], details["input"]
    if kind == "extra_forbidden":
        keys = sorted(_keys_at(model, location[:-1]))
        hint = suggestion(str(location[-1]), keys)
        return InputError(where, "an unknown key", f"one of {', '.join(keys)}", hint)
    if kind == "missing":
        return InputError(where, "nothing", "a value: this key is required")
    return InputError(where, value_text(value), expectation(details))


def expectation(details: Mapping[str, Any]) -> str:
    """The value that an error of pydantic asks for, in words for the author of the file.

    Parameters
    ----------
    details
        Details of the error: `type`, `loc`, `input`, `msg` and `ctx`.

    Returns
    -------
    str
        Words that follow "expected".
    """
    key = next((part for part in reversed(details["loc"]) if isinstance(part, str) and not part.startswith("<")), "")
    in_list = bool(details["loc"]) and isinstance(details["loc"][-1], int)
    one_for_many = details["type"] in _LIST_TYPES and isinstance(details["input"], Mapping)
    if one_for_many or (in_list and details["type"] in _TABLE_TYPES):
        return f"tables in double brackets, [[{key}]]"
    if (plain := _PLAIN.get(details["type"])) is not None:
        return plain.format(key=key, **details.get("ctx", {}))
    if details["type"] == "value_error":  # raised by the code of this program
        return str(details["ctx"]["error"])
    return "a value as the documentation of this file describes it"


def value_text(value: object) -> str:
    """A value of a file in at most 80 characters.

    Parameters
    ----------
    value
        The value.

    Returns
    -------
    str
        Its representation, cut if it is longer; the keys of a table.
    """
    if isinstance(value, date | time):  # a datetime is a date
        return f"a date or time, {value}"
    keys = ", ".join(map(str, value)) if isinstance(value, dict) else ""
    text = f"a table with the keys {keys}" if keys else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _key(location: tuple[int | str, ...]) -> str:
    """Key of a location, such as ``surface[2].material``."""
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).removeprefix(".")


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> set[str]:
    """Keys that the table at a location may have, by their names in files."""
    current = model
    for part in location:
        field = next((f for name, f in current.model_fields.items() if part in (name, f.alias)), None)
        if field is not None:
            current = _model_in(field.annotation) or current
    return {field.alias or name for name, field in current.model_fields.items()}


def _model_in(annotation: object) -> type[BaseModel] | None:
    """First pydantic model inside a type such as ``list[Model] | None``; None if there is none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((inner for part in get_args(annotation) if (inner := _model_in(part))), None)
