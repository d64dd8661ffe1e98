"""Checks of the places where a command writes, before it computes."""

from __future__ import annotations

import os
from pathlib import Path

from cboxlab.utils.errors import InputError

__all__ = ["require_file", "require_folder"]


def require_folder(path: Path) -> None:
    """Require a writable folder, or one that can be created.

    Parameters
    ----------
    path
        The folder.

    Raises
    ------
    InputError
        If there is a file, or no permission to write.
    """
    existing = path.absolute()
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(path, f"a file ({existing})", "a folder for results", "Name another folder with --out.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(path, f"a folder without write permission ({existing})", "a writable folder")


def require_file(path: Path) -> None:
    """Require a file that can be created or replaced.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If there is a folder of this name, or no permission to write into its folder.
    """
    if path.is_dir():
        raise InputError(path, "a folder", "a file name for results")
    require_folder(path.parent)
