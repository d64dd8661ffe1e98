"""The one exception for a user's mistake; the command line turns it into one line and exit code 2."""

from pathlib import Path

__all__ = ["InputError"]


class InputError(ValueError):
    """Bad input, described so that the user can mend it.

    Parameters
    ----------
    where : file (and key) at fault, for example ``"capture.toml: band[2].exposure_s"``.
    found : what stands there.
    expected : what is allowed there.
    hint : how to mend it (optional).
    """

    def __init__(self, where: str | Path, found: str, expected: str, hint: str = "") -> None:
        self.where, self.found, self.expected, self.hint = str(where), found, expected, hint
        text = f"{where}: found {found}; expected {expected}"
        super().__init__(f"{text}. {hint}" if hint else text)
