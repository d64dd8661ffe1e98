"""What a section of the report is made of; a diagnosis adds sections of the same kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .plots import Drawing, MapRow

__all__ = ["Cell", "ReportSection", "Table", "number", "significant", "to_error", "with_error"]

#: With more places behind the point numbers are easier to read with an exponent.
_MOST_PLACES = 6

MINUS = str.maketrans("-", "−")


@dataclass(frozen=True)
class Cell:
    """A table cell. note : small print under it. strong : stands out. words : may be broken into lines."""

    text: str
    note: str = ""
    strong: bool = False
    words: bool = False


@dataclass(frozen=True)
class Table:
    """header : one entry per column. rows : first the row's heading, then numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    caption: str = ""


@dataclass(frozen=True)
class ReportSection:
    """One section of the report: paragraphs of plain text, then pictures, plots and tables in order.

    finding : a sentence that belongs at the top of the report.
    """

    title: str
    paragraphs: Sequence[str] = ()
    blocks: Sequence[MapRow | Drawing | Table] = ()
    finding: str = ""


def number(value: float, digits: int = 2, sign: bool = False) -> str:
    """Fixed digits behind the point, a true minus (none for zero), a dash for NaN."""
    if not np.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{digits}f}".translate(MINUS)


def significant(value: float, digits: int = 3) -> str:
    """Significant digits, a true minus, a dash for NaN."""
    return f"{value:.{digits}g}".translate(MINUS) if np.isfinite(value) else "–"


def to_error(value: float, sigma: float) -> str:
    """As many digits as a standard deviation of two significant ones has; seven where there is none."""
    places = _places(sigma)
    return significant(value, 7) if places is None else number(value, min(places, 9))


def with_error(value: float, sigma: float) -> str:
    """Value and standard deviation to the same digit, two of the deviation's; four digits of the value without one."""
    places = _places(sigma)
    if places is None:
        return significant(value, 4)
    if places > _MOST_PLACES:
        digits = int(np.floor(np.log10(max(abs(value), sigma)))) + places + 1
        return f"{significant(value, digits)} ± {significant(sigma, 2)}"
    return f"{number(value, places)} ± {number(sigma, places)}"


def _places(sigma: float) -> int | None:
    """Behind the point, for two significant digits of a standard deviation; None where there is none."""
    return max(int(1 - np.floor(np.log10(sigma))), 0) if np.isfinite(sigma) and sigma > 0 else None
