"""Checks of arguments of public functions: paths, numbers, texts and objects."""

from __future__ import annotations

import errno
import math
import os
import re
from collections.abc import Iterable
from numbers import Integral, Real
from pathlib import Path

from .errors import InputError
from .faults import suggestion

__all__ = [
    "MAX_SEED",
    "described",
    "require_flag",
    "require_progress",
    "require_type",
    "require_word",
    "required_folder",
    "required_number",
    "required_path",
    "required_whole_number",
]

#: Largest seed of random numbers: the largest integer of TOML.
MAX_SEED = 2**63 - 1

#: Characters of an argument in a message, at most.
_MAX_DESCRIBED = 60


def described(argument: object) -> str:
    """Value of an argument in one short line, with its type unless that shows.

    Parameters
    ----------
    argument
        Any object, also one whose text cannot be formed.

    Returns
    -------
    str
        Such as "'red'", "nan", "None" or "list [1, 2]".
    """
    kind = type(argument).__name__
    try:
        text = re.sub(r"\s+", " ", repr(argument))
    except Exception:  # the object is the user's
        return f"{kind} without a text"
    shows = argument is None or isinstance(argument, str | bool | int | float)
    return text[:_MAX_DESCRIBED] if shows else f"{kind} {text[:_MAX_DESCRIBED]}"


def required_path(name: str, argument: object, expected: str = "a path") -> Path:
    """Path of an argument.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        A text or a path.
    expected
        Words for what should be there.

    Returns
    -------
    Path
        The path, which need not exist.

    Raises
    ------
    InputError
        If the argument is neither, is empty, or is no name that a file system takes.
    """
    if not isinstance(argument, str | Path) or argument == "":
        raise InputError(name, described(argument), expected)
    try:
        if b"\0" in os.fsencode(argument):
            raise InputError(name, described(argument), f"{expected} without a NUL")
        os.stat(argument)
    except ValueError:
        raise InputError(name, f"{described(argument)}, which no name can contain", expected) from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InputError(name, f"{described(argument)}..., a name that is too long", expected) from None
    return Path(argument)


def required_number(
    name: str, argument: object, *, least: float = -math.inf, most: float = math.inf, above: float | None = None
) -> float:
    """Finite number of an argument.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        A number, also one of NumPy; no text and no truth value.
    least, most
        Allowed range, both ends included.
    above
        Lower bound that is excluded, in place of ``least``; None for none.

    Returns
    -------
    float
        The number.

    Raises
    ------
    InputError
        If the argument is none, or is out of the range.
    """
    lower = f"above {above:g}" if above is not None else f"of {least:g} or more" if least > -math.inf else ""
    upper = f"of {most:g} or less" if most < math.inf else ""
    expected = " and ".join(part for part in (f"a finite number {lower}".strip(), upper) if part)
    if isinstance(argument, bool) or not isinstance(argument, Real):
        raise InputError(name, described(argument), expected)
    try:
        value = float(argument)
    except OverflowError:
        value = math.inf
    sound = math.isfinite(value) and least <= value <= most and (above is None or value > above)
    if not sound:
        raise InputError(name, described(argument), expected)
    return value


def required_whole_number(name: str, argument: object, least: int, most: int) -> int:
    """Whole number of an argument.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        A whole number, also one of NumPy; no text and no truth value.
    least, most
        Allowed range, both ends included.

    Returns
    -------
    int
        The number.

    Raises
    ------
    InputError
        If the argument is none, or is out of the range.
    """
    if isinstance(argument, bool) or not isinstance(argument, Integral) or not least <= int(argument) <= most:
        raise InputError(name, described(argument), f"a whole number from {least} to {most}")
    return int(argument)


def require_word(name: str, argument: object, allowed: Iterable[str]) -> None:
    """Require that an argument is one of some words.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        The argument.
    allowed
        The allowed words.

    Raises
    ------
    InputError
        If it is another object; the fault lists the words and the most similar one.
    """
    listed = list(allowed)
    if not isinstance(argument, str) or argument not in listed:
        hint = suggestion(argument, listed) if isinstance(argument, str) else ""
        raise InputError(name, described(argument), f"one of {', '.join(listed)}", hint)


def require_flag(name: str, argument: object) -> None:
    """Require that an argument is a truth value.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        The argument.

    Raises
    ------
    InputError
        If it is neither True nor False.
    """
    require_type(name, argument, bool, "True or False")


def require_type(name: str, argument: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Require that an argument is an object of some type.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        The argument.
    kind
        The type, or several.
    expected
        Words for what should be there.

    Raises
    ------
    InputError
        If it is of another type.
    """
    if not isinstance(argument, kind):
        raise InputError(name, described(argument), expected)


def required_folder(name: str, argument: object) -> Path:
    """Path of an argument at which a folder is, or can be made.

    Parameters
    ----------
    name
        Name of the argument, for the fault.
    argument
        A text or a path.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        As ``required_path``, and if a file is there, or in place of a folder above it.
    """
    path = required_path(name, argument, "a folder")
    existing = next((each for each in (path, *path.parents) if each.exists() or each.is_symlink()), None)
    if existing is not None and not existing.is_dir():
        raise InputError(name, f"{path}: {existing} is no folder", "a folder, or a path at which one can be made")
    return path


def require_progress(argument: object) -> None:
    """Require that an argument receives progress.

    Parameters
    ----------
    argument
        The argument ``progress``.

    Raises
    ------
    InputError
        If it lacks the methods of ``Progress``.
    """
    if not all(callable(getattr(argument, name, None)) for name in ("stage", "part")):
        raise InputError("progress", described(argument), "an object with stage(name) and part(done)")
