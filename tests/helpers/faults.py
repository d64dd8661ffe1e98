"""Small inputs that once went wrong, next to the repository; tests that need them are skipped where they are absent."""

import shutil
from pathlib import Path

import pytest

from .places import SHARED


def fault_folder(name: str, tmp_path: Path) -> Path:
    """A copy of one of the folders."""
    folder = SHARED / "faults" / name
    if not folder.is_dir():
        pytest.skip(f"no {folder}: the inputs that once went wrong are not part of the repository")
    copy = tmp_path / name
    shutil.copytree(folder, copy, copy_function=shutil.copyfile)
    for path in (copy, *copy.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return copy
