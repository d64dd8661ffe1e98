"""Contents of the page's requests, each checked before it is used."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from cboxlab.utils.errors import InputError
from starlette.requests import Request

__all__ = ["flag_of", "index_of", "json_body", "list_of", "optional_text", "text_of", "values_of"]

#: Largest body of a request, bytes: a step or a job has a few hundred.
_MAX_BODY = 1 << 16


async def json_body(request: Request) -> dict[str, Any]:
    """JSON object of a request.

    Parameters
    ----------
    request
        The request.

    Returns
    -------
    dict
        The object.

    Raises
    ------
    InputError
        For another type of content, a body that is too long, NaN or Infinity, and letters that are no Unicode.
    """
    expected = "a JSON object"
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise InputError("the request", "a body that is not application/json", expected)
    text = b""
    async for part in request.stream():
        text += part
        if len(text) > _MAX_BODY:
            raise InputError("the request", "a body that is too long", f"at most {_MAX_BODY} bytes")
    try:
        content = json.loads(text or b"{}", parse_constant=_no_number)
        json.dumps(content, ensure_ascii=False).encode()  # halves of letters, which no answer can repeat
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError("the request", repr(text[:40]), expected)
    return content


def _no_number(name: str) -> float:
    """Refuse NaN and Infinity, which JSON lacks and Python reads."""
    raise ValueError(name)


def text_of(body: Mapping[str, Any], key: str) -> str:
    """Text of a key, without outer spaces.

    Parameters
    ----------
    body
        The request's JSON object.
    key
        Key of it.

    Returns
    -------
    str
        Not empty.

    Raises
    ------
    InputError
        If it is missing, empty, or no text.
    """
    value = body.get(key)
    if not isinstance(value, str) or not value.strip():
        raise InputError(key, "nothing" if not value else repr(value)[:80], "a name")
    return value.strip()


def optional_text(body: Mapping[str, Any], key: str) -> str | None:
    """Text of a key that may be missing.

    Parameters
    ----------
    body
        The request's JSON object.
    key
        Key of it.

    Returns
    -------
    str | None
        None if it is missing, null or empty.

    Raises
    ------
    InputError
        If it is no text.
    """
    return None if body.get(key) in (None, "") else text_of(body, key)


def index_of(body: Mapping[str, Any], key: str) -> int:
    """Index of a key.

    Parameters
    ----------
    body
        The request's JSON object.
    key
        Key of it.

    Returns
    -------
    int
        From 0; 0 if it is missing.

    Raises
    ------
    InputError
        If it is no index.
    """
    value = body.get(key, 0)
    if not _is_index(value):
        raise InputError(key, repr(value)[:80], "an index from 0")
    return int(value)


def _is_index(value: object) -> bool:
    """Whether a JSON value is an integer of 0 or more; false for true and false."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def list_of(body: Mapping[str, Any], key: str, kind: type = object) -> list[Any]:
    """List of a key; empty if it is missing.

    Parameters
    ----------
    body
        The request's JSON object.
    key
        Key of it.
    kind
        ``str`` for texts, ``int`` for indices from 0, or ``object`` for records that others check.

    Returns
    -------
    list
        The values.

    Raises
    ------
    InputError
        If it is no list, or for values of another kind.
    """
    values = body.get(key, [])
    fits: Callable[[object], bool] = _is_index if kind is int else lambda value: isinstance(value, kind)
    if not isinstance(values, list) or not all(map(fits, values)):
        name = {str: "texts", int: "indices from 0"}.get(kind, "records")
        raise InputError(key, repr(values)[:80], f"a list of {name}")
    return values


def flag_of(body: Mapping[str, Any], key: str, default: bool = False) -> bool:
    """Truth value of a key.

    Parameters
    ----------
    body
        The request's JSON object.
    key
        Key of it.
    default
        Value if it is missing.

    Returns
    -------
    bool
        The value.

    Raises
    ------
    InputError
        If it is not true or false.
    """
    value = body.get(key, default)
    if not isinstance(value, bool):
        raise InputError(key, repr(value)[:80], "true or false")
    return value


def values_of(body: Mapping[str, Any]) -> dict[str, Any]:
    """Values of an effect by parameter.

    Parameters
    ----------
    body
        The request's JSON object.

    Returns
    -------
    dict
        Infinity for "inf", which JSON lacks.

    Raises
    ------
    InputError
        If a value is no number and no text.
    """
    values = body.get("values", {})
    if not isinstance(values, dict):
        raise InputError("values", repr(values)[:80], "a value for each parameter")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise InputError(f"values.{key[:40]}", repr(value)[:80], "a number or a text")
    return {str(key): math.inf if value == "inf" else value for key, value in values.items()}
