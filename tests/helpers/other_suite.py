"""The test suite of another renderer, run with our pytest plugin."""

import contextlib
import io
import subprocess
import sys
from pathlib import Path

import pytest

__all__ = ["run_suite", "run_suite_apart"]

_OPTIONS = ("-q", "-p", "cboxlab.pytest_plugin", "-p", "no:cacheprovider", "-p", "no:xdist", "--import-mode=importlib")


def run_suite(folder: Path, *options: str) -> tuple[int, str]:
    """Exit status and what pytest printed, in this process."""
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = pytest.main([*_OPTIONS, "--capture=sys", "--rootdir", str(folder), str(folder), *options])
    for name, module in list(sys.modules.items()):
        if str(folder) in (getattr(module, "__file__", None) or ""):
            del sys.modules[name]  # another folder's module may have the same name
    return int(code), printed.getvalue()


def run_suite_apart(folder: Path, *options: str) -> tuple[int, str]:
    """The same in a separate process, as a user's build runs it."""
    command = [sys.executable, "-m", "pytest", *_OPTIONS, "--rootdir", str(folder), str(folder), *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr
