"""Runs of other renderers on an export, and their times."""

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

from cboxlab.rendering.export import Renderer, renderer_of
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import folder_lock

__all__ = ["RendererRun", "missing", "run_renderer"]

#: Characters of a failed renderer's last message that are repeated: about five lines of a terminal.
_MAX_MESSAGE_LENGTH = 400


@dataclass(frozen=True)
class RendererRun:
    """Times of one renderer's run."""

    #: Identifier of the renderer.
    renderer: str
    #: Seconds of all processors together; NaN where an earlier run had done a part.
    cpu_s: float
    #: Seconds elapsed.
    wall_s: float


def missing(renderer: str) -> str:
    """Sentence on what has to be installed for a renderer.

    Parameters
    ----------
    renderer
        Identifier of the renderer.

    Returns
    -------
    str
        The sentence; empty where everything is installed.

    Raises
    ------
    InputError
        If the renderer is unknown.
    """
    record = renderer_of(renderer)
    path = _environment(record).get("PATH")
    package = not record.package or importlib.util.find_spec(record.package) is not None
    if package and all(shutil.which(program, path=path) for program in record.programs):
        return ""
    return f"{record.name} is not installed: it needs {record.needs}"


def _environment(record: Renderer) -> dict[str, str]:
    """Environment variables of a renderer's run."""
    return {**os.environ, **record.environment()}


def run_renderer(export: Path, renderer: str) -> RendererRun:
    """Run one renderer in its folder of an export, one run at a time.

    A run that waited for another one renders only what that one left out.

    Parameters
    ----------
    export
        Folder of the export.
    renderer
        Identifier of the renderer.

    Returns
    -------
    RendererRun
        Times of the run.

    Raises
    ------
    InputError
        If the renderer is unknown or not installed, or if it fails; its last message is repeated.
    """
    lacking = missing(renderer)
    if lacking:
        raise InputError("renderer", lacking, "an installed renderer")
    record, python = renderer_of(renderer), sys.executable
    command = [part.format(python=python) for part in record.command]
    with folder_lock(export / renderer):
        resumed = any((export / renderer / "out").glob("*"))
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        process = subprocess.run(
            command, cwd=export / renderer, env=_environment(record), capture_output=True, text=True, check=False
        )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        message = (process.stderr.strip() or process.stdout.strip())[-_MAX_MESSAGE_LENGTH:]
        fault = f"{' '.join(command)} ended with {process.returncode}: {message}"
        raise InputError(export / renderer, fault, "a picture")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return RendererRun(renderer, math.nan if resumed else cpu, wall)
