"""Runs other renderers on an export: which are installed, how long each takes."""

from __future__ import annotations

import importlib.util
import math
import os
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from cboxlab.rendering.export import FORMATS
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import folder_lock

__all__ = ["Run", "missing", "run_renderer"]

#: By renderer: the Python package, or the programs, that it needs.
_PACKAGES = {"mitsuba": "mitsuba", "raysect": "raysect", "luxcore": "pyluxcore"}
_PROGRAMS = {"radiance": ("oconv", "rtrace"), "pbrt": ("pbrt",)}
#: Characters of a failed renderer's own words that are repeated.
_MOST_WORDS = 400


@dataclass(frozen=True)
class Run:
    """One renderer's run. cpu_s : of all its processors together, NaN where an earlier run had done a part. wall_s :
    elapsed.
    """

    renderer: str
    cpu_s: float
    wall_s: float


def missing(renderer: str) -> str:
    """What has to be installed for a renderer; empty where it is."""
    needs = f"{FORMATS[renderer].name} is not installed: it needs {FORMATS[renderer].needs}"
    if renderer in _PACKAGES:
        return "" if importlib.util.find_spec(_PACKAGES[renderer]) else needs
    path = _environment().get("PATH")
    return "" if all(shutil.which(program, path=path) for program in _PROGRAMS[renderer]) else needs


def _environment() -> dict[str, str]:
    """With the programs of the package pyradiance, where it is installed and Radiance itself is not."""
    found = dict(os.environ)
    package = importlib.util.find_spec("pyradiance")
    if package is not None and package.origin is not None and shutil.which("rtrace") is None:
        folder = Path(package.origin).parent
        found["PATH"] = f"{folder / 'bin'}{os.pathsep}{found.get('PATH', '')}"
        found["RAYPATH"] = str(folder / "lib")
    return found


def run_renderer(export: Path, renderer: str) -> Run:
    """Run one renderer in its folder of an export, one run at a time: what another run made is not made again.

    Raises InputError where it is missing or fails, with its words.
    """
    lacking = missing(renderer)
    if lacking:
        raise InputError("renderer", lacking, "an installed renderer")
    python = sys.executable
    command = [part.format(python=python) for part in FORMATS[renderer].command]
    with folder_lock(export / renderer):
        begun = any((export / renderer / "out").glob("*"))
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(
            command, cwd=export / renderer, env=_environment(), capture_output=True, text=True, check=False
        )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        words = (done.stderr.strip() or done.stdout.strip())[-_MOST_WORDS:]
        raise InputError(export / renderer, f"{' '.join(command)} ended with {done.returncode}: {words}", "a picture")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(renderer, math.nan if begun else cpu, wall)
