"""A suspected error of a capture: what it is, where, and the evidence."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Suspicion"]


@dataclass(frozen=True)
class Suspicion:
    """A probable error made when the capture was taken or described.

    what : the mistake, in a few words. where : the key of capture.toml or the file. why : what was found and what
    was expected, with numbers.
    """

    what: str
    where: str
    why: str

    @property
    def record(self) -> dict[str, str]:
        """The entry of ``suspicions`` in calibration.json."""
        return {"what": self.what, "where": self.where, "why": self.why}

    def __str__(self) -> str:
        return f"{self.where}: {self.what}. {self.why}"
