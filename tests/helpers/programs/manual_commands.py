"""The commands and keys of the README and the manual, as they are written there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from helpers.places import ROOT

__all__ = ["NEW_USER", "commands", "described", "pages"]

#: Pages whose commands are meant to be run one after the other in the repository's folder.
NEW_USER = ("README.md", "docs/tutorial.md")

_BLOCKS = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def pages() -> list[str]:
    """All pages with commands, relative to the repository."""
    results = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [path.relative_to(ROOT).as_posix() for path in results]


def described(page: str, section: str) -> set[str]:
    """The words in code marks in the first column of a section's table, to the next heading of any level."""
    text = Path(ROOT / page).read_text(encoding="utf-8")
    _, body = re.split(rf"^#+ {re.escape(section)}$", text, maxsplit=1, flags=re.MULTILINE)
    rows = re.findall(r"^\|([^|]*)\|", re.split(r"^#+ ", body, maxsplit=1, flags=re.MULTILINE)[0], re.MULTILINE)
    return {word for row in rows for word in re.findall(r"`(\w+)`", row)}


def commands(page: str, language: str | None = None) -> list[list[str]]:
    """Words of every ``cbox`` line in the code blocks of a page, without comments; of blocks in ``language`` alone.

    Lines that state a syntax, with square brackets, are left out.
    """
    text = Path(ROOT / page).read_text(encoding="utf-8")
    lines = [
        line
        for kind, block in _BLOCKS.findall(text)
        if language in (None, kind)
        for line in block.splitlines()
        if line.startswith("cbox ") and "[" not in line
    ]
    return [shlex.split(line, comments=True)[1:] for line in lines]
