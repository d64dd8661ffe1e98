"""The labels of a capture's label image: what each number means."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from cboxlab.scenes.errors import InputError

__all__ = ["Label", "read_labels"]


@dataclass(frozen=True)
class Label:
    """One label of the label image. column : its column in the file of known spectra, None without one."""

    label: int
    name: str
    column: str | None


def read_labels(path: Path) -> tuple[Label, ...]:
    """The rows of a label table (CSV with label, name, column) in their order.

    Raises InputError for a missing column, a label that is no number from 1 to 255 or stands twice.
    """
    labels = []
    with open(path, newline="", encoding="utf-8") as stream:
        rows = csv.DictReader(stream)
        missing = [name for name in ("label", "name", "column") if name not in (rows.fieldnames or ())]
        if missing:
            raise InputError(
                path, f"a header without {', '.join(missing)}", "a header with label, name, column"
            )
        for number, row in enumerate(rows, 2):
            if not ((row["label"] or "").isdigit() and 1 <= int(row["label"]) <= 255):
                raise InputError(
                    f"{path}: row {number}, label", repr(row["label"]), "an integer from 1 to 255"
                )
            labels.append(Label(int(row["label"]), row["name"] or "", (row["column"] or "").strip() or None))
    if len({label.label for label in labels}) != len(labels):
        raise InputError(path, "a label that stands twice", "each label once")
    return tuple(labels)
