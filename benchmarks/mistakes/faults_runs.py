"""Runs of the commands that ``faults.py`` disturbs: what they leave undisturbed, and what a rerun leaves."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from faults_commands import Command
from faults_forked import Forked

#: Dates and seconds of computation, which any two runs have different.
TIMES = re.compile(rb"\d{4}-\d\d-\d\d[ T][0-9:.+]+|\b\d+(\.\d+)? s\b|\"(seconds|cpu_s|wall_s)[^,}]*")

#: Whether commands are run in forks of this process; ``faults.py`` sets it.
FORKED = False

#: Words of refusals: the result is there already, or another one was first.
TAKEN = ("exists already", "is there already", "another content than when")


def start(
    folder: Path,
    command: Command,
    prepare: Callable[[], None] | None = None,
    changed: Mapping[str, str] | None = None,
    wrapper: tuple[str, ...] = (),
) -> subprocess.Popen | Forked:
    """One program in a folder, with its own cache there.

    prepare : called in the new process. changed : variables of its environment. wrapper : words before the program.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in command.laid:
        lay(folder, name)
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "OPENBLAS_NUM_THREADS": "1"} | (changed or {})
    if FORKED:
        return Forked(command.arguments, folder, environment, prepare)
    plain = sys.executable if command.arguments[0] == "-c" else str(Path(sys.executable).with_name("cbox"))
    return subprocess.Popen(
        [*wrapper, plain, *command.arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=prepare,
    )


def lay(folder: Path, name: str) -> None:
    source, target = folder.parents[1] / "input" / name, folder / "out" / name
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True)
    else:
        shutil.copy(source, target)


def ended(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and what was said on standard error."""
    _, said = process.communicate(timeout=900)
    return process.returncode, said


def files(folder: Path) -> dict[str, bytes]:
    """Contents of all results by name."""
    out = folder / "out"
    paths = [path for path in sorted(out.rglob("*")) if path.is_file()]
    return {str(p.relative_to(out)): TIMES.sub(b"", p.read_bytes()) for p in paths}


def unfinished(name: str) -> bool:
    """Also the parts of pictures of other renderers' scripts."""
    return "-unfinished-" in name or name.endswith(".passes") or ".part." in name


def finished(folder: Path) -> dict[str, bytes]:
    """Contents of the results that stand under their final names."""
    return {n: c for n, c in files(folder).items() if not any(unfinished(part) for part in Path(n).parts)}


class Undisturbed:
    """What a command leaves when nothing disturbs it, by two runs.

    writing : from when to when files appear, s. moments : at how many the last disturbed run was looked at.
    """

    moments = 1

    def __init__(self, work: Path, command: Command, name: str) -> None:
        runs = []
        for number in (1, 2):
            path = work / name / f"undisturbed-{number}"
            shutil.rmtree(path, ignore_errors=True)
            begun = time.monotonic()
            process = start(path, command)
            self.before = files(path)
            self.writing, entries_before = [], set(self.before)
            while process.poll() is None:
                time.sleep(0.01)
                entries = {str(p) for p in (path / "out").rglob("*")} if (path / "out").is_dir() else set()
                if entries != entries_before:
                    self.writing, entries_before = [*self.writing, time.monotonic() - begun], entries
            self.seconds = time.monotonic() - begun
            code, said = ended(process)
            if code:
                raise RuntimeError(f"{name}: {said}")
            runs.append(files(path))
        self.sound: set[str] = set()  # states of the folders from which a rerun ended well
        self.kilobytes = {part: _kilobytes(path / part) for part in ("out", "cache")}
        self.whole = runs[0]
        self.steady = {name for name, content in self.whole.items() if runs[1].get(name) == content}

    def unlike(self, contents: dict[str, bytes]) -> list[str]:
        """Names that this has not, or whose content is neither the same nor what lay there before."""
        return [
            name
            for name, content in contents.items()
            if name not in self.whole
            or (name in self.steady and content not in (self.whole[name], self.before.get(name)))
        ]

    def fault_of_rerun(self, folder: Path, command: Command) -> str:
        """Run again in ``place``: what is not as in an undisturbed run, empty if all is."""
        code, said = ended(start(folder, command))
        contents = files(folder)
        if code and not (code == 2 and any(phrase in said for phrase in TAKEN)):
            return f"rerun {code}: {said.strip()[-300:]}"
        if unfinished_files := [name for name in contents if any(unfinished(part) for part in Path(name).parts)]:
            return f"left: {unfinished_files[:3]}"
        if set(contents) != set(self.whole):
            return f"other files: {sorted(set(contents) ^ set(self.whole))[:5]}"
        changed = [name for name in self.steady if contents[name] != self.whole[name]]
        return f"other bits: {changed}" if changed else ""


def _kilobytes(folder: Path) -> int:
    """In blocks of 4 KiB, as a file system counts."""
    return sum(4 * -(-p.stat().st_size // 4096) if p.is_file() else 4 for p in folder.rglob("*"))
