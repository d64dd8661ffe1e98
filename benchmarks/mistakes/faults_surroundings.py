"""Surroundings that misbehave: a clock that jumps, a folder that stalls, folders of another user."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

from faults_commands import Command
from faults_runs import Undisturbed, ended, files, start, unfinished

__all__ = ["SURROUNDINGS"]

#: A user who is not root, and reads what root reads, such as an interpreter below root's home; needs `setpriv`.
_OTHER_USER = 65534
_AS_ANOTHER = (
    "setpriv",
    f"--reuid={_OTHER_USER}",
    f"--regid={_OTHER_USER}",
    "--clear-groups",
    "--inh-caps=-all,+dac_read_search",
    "--ambient-caps=-all,+dac_read_search",
    "--bounding-set=-all,+dac_read_search",
)


@cache
def _library(work: Path) -> Path:
    """``surroundings.c``, built with the C compiler."""
    target = work / "surroundings.so"
    source = Path(__file__).with_name("surroundings.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(target), str(source), "-ldl"], check=True)
    return target


def _like_undisturbed(folder: Path, code: int, said: str, plain: Undisturbed) -> str:
    """What is not as in an undisturbed run, empty if all is."""
    if code or "Traceback" in said:
        return f"exit code {code}: {said.strip()[-300:]}"
    contents = files(folder)
    if set(contents) != set(plain.whole):
        return f"other files: {sorted(set(contents) ^ set(plain.whole))[:5]}"
    changed = [name for name in plain.steady if contents[name] != plain.whole[name]]
    return f"other bits: {changed}" if changed else ""


def clock(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    changed = {"LD_PRELOAD": str(_library(folder.parents[1])), "CBOX_CLOCK": "1"}
    return _like_undisturbed(folder, *ended(start(folder, command, changed=changed)), plain)


def stall(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    changed = {"LD_PRELOAD": str(_library(folder.parents[1])), "CBOX_STALL": str(folder)}
    return _like_undisturbed(folder, *ended(start(folder, command, changed=changed)), plain)


def home(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    """Another user, whose home and cache cannot be written: the results are the same."""
    changed = {"HOME": _foreign(folder / "home"), "XDG_CACHE_HOME": _foreign(folder / "home" / "cache")}
    (folder / "out").mkdir()
    for path in (folder, folder / "out"):
        os.chown(path, _OTHER_USER, _OTHER_USER)
    process = start(folder, command, changed=changed, wrapper=_AS_ANOTHER)
    return _like_undisturbed(folder, *ended(process), plain)


def results(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    """Another user, who may not write where the results belong: exit code 2, one line, and nothing is written."""
    _foreign(folder / "out")
    code, said = ended(start(folder, command, wrapper=_AS_ANOTHER))
    if code != 2 or said.count("error: ") != 1 or "Traceback" in said:
        return f"exit code {code}: {said.strip()[-300:]}"
    shutil.rmtree(folder / "cache", ignore_errors=True)
    written = [name for name in files(folder) if name not in plain.before or unfinished(name)]
    return f"written: {written}" if written else ""


def _foreign(path: Path) -> str:
    """A folder that only root may write."""
    path.mkdir(parents=True)
    path.chmod(0o755)
    return str(path)


#: By name of the kind. The last two need root.
SURROUNDINGS: dict[str, Callable[[Path, Command, Undisturbed, float, int], str]] = {
    "clock": clock,
    "stall": stall,
    "home": home,
    "results": results,
}
