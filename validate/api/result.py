"""What every result of the public face does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

__all__ = ["Result"]


class Result(ABC):
    """A result that prints as a few lines, the finding first."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """What was found, of numbers, strings, lists and dicts alone: ready for JSON, no NaN."""

    @abstractmethod
    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the result into a folder, which is made where it is missing; returns the files, the main one first.

        Each file is complete or not there.
        """

    @abstractmethod
    def lines(self) -> list[str]:
        """The result in a few lines, the finding first."""

    def __str__(self) -> str:
        return "\n".join(self.lines())

    __repr__ = __str__
