"""The parts of a section of the report; a diagnosis adds sections of the same kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .plots import Drawing, MapRow

__all__ = [
    "Cell",
    "Headline",
    "ReportSection",
    "Story",
    "Table",
    "number",
    "percent",
    "significant",
    "to_error",
    "with_error",
]

#: Numbers that need more decimal places are written with an exponent.
_MOST_PLACES = 6

MINUS = str.maketrans("-", "−")


@dataclass(frozen=True)
class Cell:
    """A table cell. note : small print under it. strong : bold. words : text that may be broken into lines."""

    text: str
    note: str = ""
    strong: bool = False
    words: bool = False


@dataclass(frozen=True)
class Table:
    """header : one entry per column. rows : each with its heading first."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    caption: str = ""


@dataclass(frozen=True)
class ReportSection:
    """One section of the report: paragraphs of plain text, then pictures, plots and tables in order, then steps.

    steps : sentences of a list.
    """

    title: str
    paragraphs: Sequence[str] = ()
    blocks: Sequence[MapRow | Drawing | Table] = ()
    steps: Sequence[str] = ()


@dataclass(frozen=True)
class Headline:
    """The top of the report. sentence : the cause and its size, or that there is none. details : further sentences.

    pictures : what shows it.
    """

    sentence: str
    details: Sequence[str]
    pictures: MapRow


@dataclass(frozen=True)
class Story:
    """What a report tells of causes. missing, falling, next : its chapters; falling None where nothing was added.

    unexplained : chapters on what no effect explains.
    """

    headline: Headline
    missing: ReportSection
    falling: ReportSection | None
    next: ReportSection
    unexplained: Sequence[ReportSection] = ()


def number(value: float, digits: int = 2, sign: bool = False) -> str:
    """The value with ``digits`` decimal places and a minus sign (none for zero); a dash for NaN."""
    if not np.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{digits}f}".translate(MINUS)


def percent(share: float, digits: int = 1) -> str:
    """A share in percent, without the sign of percent; a dash for NaN."""
    return number(100 * share, digits)


def significant(value: float, digits: int = 3) -> str:
    """The value with ``digits`` significant digits and a minus sign; a dash for NaN."""
    return f"{value:.{digits}g}".translate(MINUS) if np.isfinite(value) else "–"


def to_error(value: float, sigma: float) -> str:
    """The value, rounded to two significant digits of its standard deviation; seven digits without one."""
    places = _places(sigma)
    return significant(value, 7) if places is None else number(value, min(places, 9))


def with_error(value: float, sigma: float) -> str:
    """Value ± standard deviation, to two significant digits of the latter; four digits of the value without one."""
    places = _places(sigma)
    if places is None:
        return significant(value, 4)
    if places > _MOST_PLACES:
        digits = int(np.floor(np.log10(max(abs(value), sigma)))) + places + 1
        return f"{significant(value, digits)} ± {significant(sigma, 2)}"
    return f"{number(value, places)} ± {number(sigma, places)}"


def _places(sigma: float) -> int | None:
    """Decimal places for two significant digits of a standard deviation; None without one."""
    return max(int(1 - np.floor(np.log10(sigma))), 0) if np.isfinite(sigma) and sigma > 0 else None
