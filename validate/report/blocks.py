"""Building blocks of the report: tables, sections, the headline, and numbers as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .plots import Drawing, MapRow

__all__ = [
    "Cell",
    "Headline",
    "ReportSection",
    "ReportTable",
    "Story",
    "number",
    "percent",
    "significant",
    "to_error",
    "with_error",
]

#: Most decimal places of a number; smaller numbers are written with an exponent.
_MAX_PLACES = 6

#: Most decimal places of a value that is rounded to its standard deviation.
_MAX_PLACES_OF_VALUE = 9

#: Translation of the hyphen to a minus sign.
MINUS = str.maketrans("-", "−")


@dataclass(frozen=True)
class Cell:
    """A table cell."""

    #: Text of the cell.
    text: str
    #: Small print under it.
    note: str = ""
    #: Whether it is bold.
    strong: bool = False
    #: Whether its text may be broken into lines.
    wrap: bool = False


@dataclass(frozen=True)
class ReportTable:
    """A table of the report."""

    #: One entry per column.
    header: Sequence[str]
    #: Rows, each with its heading first.
    rows: Sequence[Sequence[str | Cell]]
    #: Caption below the table; none if empty.
    caption: str = ""


@dataclass(frozen=True)
class ReportSection:
    """One section of the report."""

    #: Heading.
    title: str
    #: Paragraphs of plain text.
    paragraphs: Sequence[str] = ()
    #: Pictures, plots and tables in their order, after the text.
    blocks: Sequence[MapRow | Drawing | ReportTable] = ()
    #: Sentences of a list, between text and blocks.
    steps: Sequence[str] = ()


@dataclass(frozen=True)
class Headline:
    """Top of the report."""

    #: The result in one sentence: the cause and its size, or that there is none.
    sentence: str
    #: Further sentences.
    details: Sequence[str]
    #: Pictures of the difference and of its cause.
    pictures: MapRow


@dataclass(frozen=True)
class Story:
    """Chapters of the report on causes of the difference."""

    #: Top of the report.
    headline: Headline
    #: Chapter on effects that the model lacks.
    missing: ReportSection
    #: Chapter on the error after each added effect; None if no effect was added.
    falling: ReportSection | None
    #: Chapter on further steps.
    next: ReportSection
    #: Chapters on the difference that no effect explains.
    unexplained: Sequence[ReportSection] = ()


def number(value: float, digits: int = 2, sign: bool = False) -> str:
    """Number as text with a fixed number of decimal places.

    Parameters
    ----------
    value
        The number.
    digits
        Decimal places.
    sign
        Whether a positive number has a plus sign.

    Returns
    -------
    str
        Text with a minus sign, zero without sign; a dash for NaN.
    """
    if not np.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{digits}f}".translate(MINUS)


def percent(share: float, digits: int = 1) -> str:
    """Share in percent as text, without the percent sign.

    Parameters
    ----------
    share
        The share, 1 for all.
    digits
        Decimal places.

    Returns
    -------
    str
        Text; a dash for NaN.
    """
    return number(100 * share, digits)


def significant(value: float, digits: int = 3) -> str:
    """Number as text with significant digits.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.

    Returns
    -------
    str
        Text with a minus sign; a dash for NaN.
    """
    return f"{value:.{digits}g}".translate(MINUS) if np.isfinite(value) else "–"


def to_error(value: float, sigma: float) -> str:
    """Value rounded to two significant digits of its standard deviation.

    Parameters
    ----------
    value
        The value.
    sigma
        Its standard deviation; NaN or 0 if not known.

    Returns
    -------
    str
        Text; seven significant digits without a standard deviation.
    """
    decimals = _decimals(sigma)
    return significant(value, 7) if decimals is None else number(value, min(decimals, _MAX_PLACES_OF_VALUE))


def with_error(value: float, sigma: float) -> str:
    """Value ± standard deviation, to two significant digits of the latter.

    Parameters
    ----------
    value
        The value.
    sigma
        Its standard deviation; NaN or 0 if not known.

    Returns
    -------
    str
        Text; four significant digits of the value without a standard deviation.
    """
    decimals = _decimals(sigma)
    if decimals is None:
        return significant(value, 4)
    if decimals > _MAX_PLACES:
        digits = int(np.floor(np.log10(max(abs(value), sigma)))) + decimals + 1
        return f"{significant(value, digits)} ± {significant(sigma, 2)}"
    return f"{number(value, decimals)} ± {number(sigma, decimals)}"


def _decimals(sigma: float) -> int | None:
    """Decimal places for two significant digits of a standard deviation; None without one."""
    return max(int(1 - np.floor(np.log10(sigma))), 0) if np.isfinite(sigma) and sigma > 0 else None
