"""The exception for bad input; the command line prints it and ends with exit code 2."""

from __future__ import annotations

from pathlib import Path

__all__ = ["InputError"]


class InputError(ValueError):
    """Bad input: where it is, the value found, the values allowed, the correction.

    The message is "WHERE: found FOUND; expected EXPECTED. HINT".

    Parameters
    ----------
    where
        File (and key) at fault, for example ``"capture.toml: band[2].exposure_s"``.
    found
        The value found, in words.
    expected
        The values allowed, in words.
    hint
        How to correct it, as a sentence; empty for none.
    """

    def __init__(self, where: str | Path, found: str, expected: str, hint: str = "") -> None:
        self.where, self.found, self.expected, self.hint = str(where), found, expected, hint
        text = f"{where}: found {found}; expected {expected}"
        super().__init__(f"{text}. {hint}" if hint else text)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle the four parts, so that the error passes from one process to another."""
        return type(self), (self.where, self.found, self.expected, self.hint)
