"""The label table of a capture: the meaning of each number in the label image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_rows

__all__ = ["Label", "read_labels"]

#: Name of a label whose pixels are left out.
EXCLUDED = "excluded"


@dataclass(frozen=True)
class Label:
    """One row of the label table."""

    #: Number in the label image, 1 to 255.
    label: int
    #: Name of the patch.
    name: str
    #: Column of the patch in the reflectance file; None if it has none.
    column: str | None

    @property
    def excludes(self) -> bool:
        """Whether its pixels are left out of everything that is measured, fitted or compared."""
        return self.name.strip().lower() == EXCLUDED


def read_labels(path: Path) -> tuple[Label, ...]:
    """The rows of a label table.

    Parameters
    ----------
    path
        CSV file with the columns label, name, column.

    Returns
    -------
    tuple
        One Label per row, in its order.

    Raises
    ------
    InputError
        For a missing column, and for a label that is not an integer from 1 to 255 or is repeated.
    """
    lines = read_rows(path, "a CSV file of labels")
    header = lines[0][1] if lines else []
    if missing := [name for name in ("label", "name", "column") if name not in header]:
        raise InputError(path, f"a header without {', '.join(missing)}", "a header with label, name, column")
    labels = []
    for line, cells in lines[1:]:
        if len(cells) != len(header):
            raise InputError(f"{path}: line {line}", f"{len(cells)} cells", f"{len(header)} as in the header")
        row = dict(zip(header, cells, strict=True))
        if not (row["label"].isascii() and row["label"].isdigit() and 1 <= int(row["label"][:9]) <= 255):
            raise InputError(f"{path}: line {line}, label", repr(row["label"]), "an integer from 1 to 255")
        labels.append(Label(int(row["label"]), row["name"], row["column"].strip() or None))
    if len({label.label for label in labels}) != len(labels):
        raise InputError(path, "a repeated label", "each label once")
    return tuple(labels)
