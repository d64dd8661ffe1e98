"""The exception for bad input; the command line prints it and ends with exit code 2."""

from __future__ import annotations

from pathlib import Path

__all__ = ["InputError"]


class InputError(ValueError):
    """Bad input, with its place, its value, the values allowed and the correction.

    The message is "WHERE: found FOUND; expected EXPECTED. HINT". The four parts are attributes.

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

    Examples
    --------
    >>> import cboxlab
    >>> try:
    ...     cboxlab.load_scene("cornel-box")
    ... except cboxlab.InputError as error:
    ...     print(error.where, "/", error.found, "/", error.hint)
    cornel-box / no such file / Did you mean 'cornell-box'?
    """

    def __init__(self, where: str | Path, found: str, expected: str, hint: str = "") -> None:
        #: File and key at fault.
        self.where = str(where)
        #: Value found, in words.
        self.found = found
        #: Values allowed, in words.
        self.expected = expected
        #: Correction, as a sentence; empty for none.
        self.hint = hint
        text = f"{where}: found {found}; expected {expected}"
        super().__init__(f"{text}. {hint}" if hint else text)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle the four parts, so that the error passes from one process to another."""
        return type(self), (self.where, self.found, self.expected, self.hint)
