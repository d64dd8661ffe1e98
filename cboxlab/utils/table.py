"""Tables of text, which the terminal and notebooks show."""

from __future__ import annotations

from dataclasses import dataclass

from .page_text import escaped

__all__ = ["Table"]


@dataclass(frozen=True)
class Table:
    """A titled table of text."""

    #: What the rows are, with the unit of the numbers.
    title: str
    #: Header of each column.
    columns: tuple[str, ...]
    #: Cells of each row, one for each column.
    rows: tuple[tuple[str, ...], ...]
    #: Indices of columns of text, which may be wrapped; the others hold numbers.
    text_columns: tuple[int, ...] = (0,)

    def _repr_html_(self) -> str:
        """HTML table, for notebooks."""
        head = "".join(f"<th>{escaped(column)}</th>" for column in self.columns)
        rows = ("".join(f"<td>{escaped(cell)}</td>" for cell in row) for row in self.rows)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        caption = f"<caption>{escaped(self.title)}</caption>"
        return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
