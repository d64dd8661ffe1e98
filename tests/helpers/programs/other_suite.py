"""The test suite of another renderer, run with our pytest plugin."""

import subprocess
import sys
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

__all__ = ["run_suite", "run_suite_apart"]

_OPTIONS = ("-q", "-p", "cboxlab.pytest_plugin", "-p", "no:cacheprovider", "-p", "no:xdist", "--import-mode=importlib")


def run_suite(folder: Path, *options: str) -> tuple[int, str]:
    """Exit status and what pytest printed, in this process: a new one takes seconds for its imports."""
    names = [path.stem for path in folder.glob("test_*.py")]
    # another suite may have a module of the same name, and this process one of ours
    others = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    with chdir(folder), redirect_stdout(StringIO()) as printed:
        code = pytest.main([*_arguments(folder), "--capture=no", "-p", "no:faulthandler", *options])
    for name in names:
        sys.modules.pop(name, None)
    sys.modules.update(others)
    return int(code), printed.getvalue()


def run_suite_apart(folder: Path, *options: str) -> tuple[int, str]:
    """The same in a separate process, as a user's build runs it."""
    command = [sys.executable, "-m", "pytest", *_arguments(folder), *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def _arguments(folder: Path) -> list[str]:
    return [*_OPTIONS, "--rootdir", str(folder), str(folder)]
