"""Numbers in texts of files and options, spelled as in a table.

Python's ``int`` and ``float`` accept more: 4_00, digits of other alphabets, nan and infinity.
"""

from __future__ import annotations

import re

__all__ = ["number_of", "whole_number_of"]

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
