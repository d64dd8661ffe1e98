"""Numbers in texts of files and options, spelled as in a table, and in JSON.

Python's ``int`` and ``float`` accept more: 4_00, digits of other alphabets, nan and infinity.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

__all__ = ["json_value", "number_of", "whole_number_of"]

#: Most characters of a number: longer texts are none, and Python converts them slowly.
_LONGEST = 100

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)


def number_of(text: str) -> float:
    """Number of a text.

    Parameters
    ----------
    text
        Digits with a sign, a decimal point and an exponent, or without them; blanks around them are ignored.

    Returns
    -------
    float
        The number; nan for any other text. It is infinite beyond the range of double precision.
    """
    digits = text.strip()
    return float(digits) if len(digits) <= _LONGEST and _NUMBER.fullmatch(digits) else float("nan")


def whole_number_of(text: str) -> int | None:
    """Whole number of a text.

    Parameters
    ----------
    text
        Digits with a sign, or without one; blanks around them are ignored.

    Returns
    -------
    int | None
        The number; None for any other text.
    """
    digits = text.strip()
    return int(digits) if len(digits) <= _LONGEST and _WHOLE.fullmatch(digits) else None


def json_value(value: Any) -> Any:
    """Value for JSON, which has no NaN and no infinity.

    Parameters
    ----------
    value
        Numbers, texts, paths, and lists, tuples and mappings of them, at any depth.

    Returns
    -------
    Any
        The same in dicts and lists. Numbers that are not finite are None, paths are texts.
    """
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if isinstance(value, Real) and not isinstance(value, Integral):
        return float(value) if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
