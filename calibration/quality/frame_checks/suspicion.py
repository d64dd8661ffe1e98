"""Suspected error of a capture."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Suspicion"]


@dataclass(frozen=True)
class Suspicion:
    """A probable error made when the capture was taken or described."""

    #: The error, in a few words.
    what: str

    #: The key of capture.toml, or the file.
    where: str

    #: What was measured and what was expected, with numbers.
    why: str

    @property
    def record(self) -> dict[str, str]:
        """The entry of ``suspicions`` in calibration.json."""
        return {"what": self.what, "where": self.where, "why": self.why}

    def __str__(self) -> str:
        return f"{self.where}: {self.what}. {self.why}"
