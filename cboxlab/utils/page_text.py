"""Text of pages: a line never ends between a number and its unit."""

from __future__ import annotations

import re
from html import escape
from typing import Any

__all__ = ["UNITS", "escaped", "unbroken"]

#: Units that stay on the line of their number. ``text.js`` of the viewer has the same ones.
UNITS = (
    *("%", "°", "σ", "°C", "K", "nm", "µm", "mm", "cm", "m", "px", "DN", "e⁻"),
    *("s", "ms", "min", "h", "kB", "MB", "GB", "W", "lm", "lx", "cd"),
)

_BEFORE_UNIT = re.compile(rf"(?<=\d) (?=(?:{'|'.join(UNITS)})(?!\w))")


def unbroken(value: Any) -> Any:
    """Text with a non-breaking space between each number and its unit.

    Parameters
    ----------
    value
        Plain text. Other values are returned as they are, markup too: pictures and scripts stay unchanged.

    Returns
    -------
    Any
        The text for a page.

    Examples
    --------
    >>> unbroken("407 nm: 5 % in 3 measurements")
    '407\\xa0nm: 5\\xa0% in 3 measurements'
    """
    return _BEFORE_UNIT.sub("\u00a0", value) if type(value) is str else value


def escaped(text: str) -> str:
    """HTML of plain text, with numbers and units unbroken.

    Parameters
    ----------
    text
        The text.

    Returns
    -------
    str
        Escaped text.
    """
    return escape(unbroken(text))
