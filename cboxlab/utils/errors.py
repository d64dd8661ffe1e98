"""The exception for bad input; the command line prints it and ends with exit code 2."""

from __future__ import annotations

from pathlib import Path

__all__ = ["InputError", "printable"]

#: Characters that end a line, move the cursor or change what a terminal shows, with their escapes.
_ESCAPES = {
    code: repr(chr(code))[1:-1] for code in (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F))
}


def printable(text: str) -> str:
    """Text without control characters, for a message of one line.

    Parameters
    ----------
    text
        Any text, such as the name of a file.

    Returns
    -------
    str
        The text with escapes, such as a backslash and n, in place of control characters.
    """
    return text.translate(_ESCAPES)


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
        self.where = printable(str(where))
        #: Value found, in words.
        self.found = printable(found)
        #: Values allowed, in words.
        self.expected = printable(expected)
        #: Correction, as a sentence; empty for none.
        self.hint = hint
        text = f"{self.where}: found {self.found}; expected {self.expected}"
        super().__init__(f"{text}. {hint}" if hint else text)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle the four parts, so that the error passes from one process to another."""
        return type(self), (self.where, self.found, self.expected, self.hint)
