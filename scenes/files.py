"""Writing files and folders so that they are either complete or absent, and say where they come from."""

from __future__ import annotations

import glob
import os
import platform
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

from .errors import InputError

__all__ = ["origin", "replacing", "replacing_folder", "this_command"]


def _public(path: Path, mode: int) -> None:
    """Give a temporary file the permissions of any other new file (temporary files are private)."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(mode & ~mask)


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders for ``path`` whose process, on this machine, is gone."""
    start = f".{path.name}-unfinished-{platform.node()}-"
    for left in path.parent.glob(glob.escape(start) + "*"):
        owner = left.name.removeprefix(start).split("-")[0]
        if owner.isdigit() and not _running(int(owner)):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)


def _running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _temporary_prefix(path: Path) -> str:
    """Names say which process on which machine writes, so that what a killed one leaves is recognised."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path)
    return f".{path.name}-unfinished-{platform.node()}-{os.getpid()}-"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path`` to write to; it becomes ``path`` only if the block succeeds.

    What a killed process has left beside ``path`` is removed.
    """
    path = Path(path)
    handle, name = tempfile.mkstemp(prefix=_temporary_prefix(path), suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        _public(temporary, 0o666)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside ``path`` to fill; it becomes ``path`` only if the block succeeds.

    Raises InputError if ``path`` exists and is not an empty folder: existing files are not overwritten.
    """
    path = Path(path)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(path, "something that exists already", "a new or empty folder", "Name another one.")
    temporary = Path(tempfile.mkdtemp(prefix=_temporary_prefix(path), dir=path.parent))
    try:
        yield temporary
        _public(temporary, 0o777)
        temporary.replace(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def this_command() -> str:
    """The command of this process as typed; for a library's caller that of its own program."""
    name, *arguments = sys.argv or [""]
    program = Path(name)
    shown = f"python -m {program.parent.name}" if program.name == "__main__.py" else program.name
    return f"{shown} {shlex.join(arguments)}".strip()


def origin(**further: str) -> dict[str, str]:
    """Attributes of a file, all of them text: ``further`` ones, ``cboxlab_version`` and ``command``."""
    return {**further, "cboxlab_version": version("cboxlab"), "command": this_command()}
