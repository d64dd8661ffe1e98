"""The test suite of another renderer, run with our pytest plugin."""

import subprocess
import sys
from pathlib import Path

__all__ = ["run_suite"]

_OPTIONS = ("-q", "-p", "cboxlab.pytest_plugin", "-p", "no:cacheprovider", "-p", "no:xdist", "--import-mode=importlib")


def run_suite(folder: Path, *options: str) -> tuple[int, str]:
    """Exit status and what pytest printed, in a separate process, as a user's build runs it."""
    command = [sys.executable, "-m", "pytest", *_OPTIONS, "--rootdir", str(folder), str(folder), *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr
