"""The manifest of a command's results: from which inputs, with which versions, they were made; and its check.

It is manifest.json in a folder of results, and NAME.manifest.json beside a single file.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing, this_command
from cboxlab.utils.input_files import read_json

__all__ = ["MANIFEST", "Verification", "is_current", "verify", "write_manifest"]

MANIFEST = "manifest.json"

_FORMAT = "result-manifest/1"

#: What the figures depend on beside the program itself.
_PACKAGES = ("cboxlab", "drjit", "mitsuba", "numpy", "opencv-contrib-python-headless", "scipy")

_EXPECTED = "the manifest that cbox writes with its results"


@dataclass(frozen=True)
class Verification:
    """What differs from the manifest: paths of files that have another content, and of files that are gone.

    outputs, inputs : how many files the manifest lists of each.
    """

    outputs: int
    inputs: int
    changed_outputs: tuple[str, ...]
    missing_outputs: tuple[str, ...]
    changed_inputs: tuple[str, ...]
    missing_inputs: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing differs."""
        return not (self.changed_outputs or self.missing_outputs or self.changed_inputs or self.missing_inputs)

    def lines(self) -> list[str]:
        """What differs, one line for each file."""
        told = {
            "this result has changed": self.changed_outputs,
            "this result is gone": self.missing_outputs,
            "this input has changed since": self.changed_inputs,
            "this input is gone": self.missing_inputs,
        }
        return [f"{path}: {words}" for words, paths in told.items() for path in paths]


def write_manifest(results: Path, outputs: Iterable[Path], inputs: Sequence[Path], *, seed: int | None = None) -> Path:
    """Write the manifest of a folder of results, or of a file. Outputs are given relative to its folder, inputs by
    absolute paths.

    outputs : files below the manifest's folder, or folders there. inputs : the same anywhere; a packaged model's name,
    which is no file, is left out. seed : of the render, or of the noise.
    """
    place = _place(results)
    mitsuba = sys.modules.get("mitsuba")
    content = {
        "format": _FORMAT,
        "command": this_command(),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
        "mitsuba_variant": None if mitsuba is None else mitsuba.variant(),
        "seed": seed,
        "inputs": {str(path): _content(path) for one in inputs for path in _files(one.resolve())},
        "outputs": {
            path.relative_to(place.parent).as_posix(): _content(path) for one in outputs for path in _files(one)
        },
    }
    with replacing(place) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return place


def verify(results: Path) -> Verification:
    """Compare a folder of results, or a file, and the inputs that they were made from, with the manifest.

    Raises InputError where there is no manifest, or something else in its place.
    """
    place = _place(results)
    content = read_json(place, _EXPECTED)
    outputs, inputs = (_entries(content, key, place) for key in ("outputs", "inputs"))
    if any(Path(name).is_absolute() or ".." in Path(name).parts for name in outputs):
        raise InputError(place, "results outside the folder", _EXPECTED)
    changed, missing = _compared({name: place.parent / name for name in outputs}, outputs)
    changed_inputs, missing_inputs = _compared({name: Path(name) for name in inputs}, inputs)
    return Verification(len(outputs), len(inputs), changed, missing, changed_inputs, missing_inputs)


def is_current(folder: Path, command: str) -> bool:
    """Whether a folder has the results of a command, and neither they nor their inputs have changed since."""
    try:
        content = read_json(folder / MANIFEST, _EXPECTED)
        return isinstance(content, dict) and content.get("command") == command and verify(folder).sound
    except InputError:
        return False


def _place(results: Path) -> Path:
    return results / MANIFEST if results.is_dir() else results.with_name(f"{results.name}.{MANIFEST}")


def _files(path: Path) -> list[Path]:
    """A file itself, or all files of a folder; none of a path where nothing is."""
    return sorted(p for p in (path, *path.rglob("*")) if p.is_file())


def _content(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        return {"bytes": path.stat().st_size, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def _entries(content: Any, key: str, place: Path) -> Mapping[str, Mapping[str, Any]]:
    sound = isinstance(content, dict) and content.get("format") == _FORMAT
    entries = content.get(key) if sound else None
    if not isinstance(entries, dict) or not all(
        isinstance(e, dict) and isinstance(e.get("sha256"), str) for e in entries.values()
    ):
        raise InputError(place, "other content", _EXPECTED)
    return entries


def _compared(
    paths: Mapping[str, Path], entries: Mapping[str, Mapping[str, Any]]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Files of another content, and those that are gone."""
    there = {name: path for name, path in paths.items() if path.is_file()}
    changed = [name for name, path in there.items() if _content(path)["sha256"] != entries[name]["sha256"]]
    return tuple(changed), tuple(name for name in paths if name not in there)
