"""The base of all results of the public functions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cboxlab.utils.page_text import escaped
from cboxlab.utils.table import Table

__all__ = ["Result", "as_html"]


class Result(ABC):
    """A result that prints as a few lines, the finding first, and shows tables in a notebook."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Content as numbers, strings, lists and dicts alone.

        Returns
        -------
        dict
            Ready for JSON; a number that is not finite is None.
        """

    @abstractmethod
    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the result's files, each complete or not at all.

        Parameters
        ----------
        folder
            Folder of the files; it is created where it is missing.

        Returns
        -------
        tuple of Path
            The files, the main one first.
        """

    @abstractmethod
    def lines(self) -> list[str]:
        """Sentences of the result.

        Returns
        -------
        list of str
            The finding first; at most a dozen.
        """

    def tables(self) -> list[Table]:
        """Tables of the result.

        Returns
        -------
        list of Table
            The most important one first; empty if the sentences say everything.
        """
        return []

    def __str__(self) -> str:
        return "\n".join(self.lines())

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Lines and tables, for notebooks."""
        return as_html(self.lines(), self.tables())


def as_html(lines: Sequence[str], tables: Sequence[Table]) -> str:
    """Lines and tables as HTML.

    Parameters
    ----------
    lines
        Sentences, each a paragraph.
    tables
        Tables below them.

    Returns
    -------
    str
        HTML.
    """
    text = "".join(f"<p>{escaped(line)}</p>" for line in lines)
    return text + "".join(table._repr_html_() for table in tables)
