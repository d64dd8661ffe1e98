"""Building blocks of the report: tables, sections, the headline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .plots import Drawing, MapRow

__all__ = [
    "Cell",
    "Headline",
    "ReportSection",
    "ReportTable",
    "Story",
]


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
