"""The exception for bad input. The command line prints it and ends with exit code 2."""

from __future__ import annotations

from pathlib import Path

__all__ = ["InputError"]


class InputError(ValueError):
    """Bad input: where it is, what was found, what is allowed, how to correct it.

    Parameters
    ----------
    where : file (and key) at fault, for example ``"capture.toml: band[2].exposure_s"``.
    found : the value found.
    expected : the values allowed.
    hint : how to correct it (optional).
    """

    def __init__(self, where: str | Path, found: str, expected: str, hint: str = "") -> None:
        self.where, self.found, self.expected, self.hint = str(where), found, expected, hint
        text = f"{where}: found {found}; expected {expected}"
        super().__init__(f"{text}. {hint}" if hint else text)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle the four parts, so that the error passes from one process to another."""
        return type(self), (self.where, self.found, self.expected, self.hint)
