"""Manifest of a command's results, with their inputs and the versions of the program.

A folder of results has manifest.json. A single file NAME has NAME.manifest.json next to it.
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

#: File of the manifest in a folder of results.
MANIFEST = "manifest.json"

_FORMAT = "result-manifest/1"

#: Packages on which figures depend, whose versions a manifest states.
_PACKAGES = ("cboxlab", "drjit", "mitsuba", "numpy", "opencv-contrib-python-headless", "scipy")

_EXPECTED = "the manifest that cbox writes with its results"


@dataclass(frozen=True)
class Verification:
    """Differences between files and their manifest."""

    #: Number of results that the manifest lists.
    outputs: int
    #: Number of inputs that the manifest lists.
    inputs: int
    #: Paths of results whose content differs, relative to the manifest's folder.
    changed_outputs: tuple[str, ...]
    #: Paths of results that do not exist.
    missing_outputs: tuple[str, ...]
    #: Absolute paths of inputs whose content differs.
    changed_inputs: tuple[str, ...]
    #: Absolute paths of inputs that do not exist.
    missing_inputs: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing differs."""
        return not (self.changed_outputs or self.missing_outputs or self.changed_inputs or self.missing_inputs)

    def lines(self) -> list[str]:
        """Differences, one sentence for each file.

        Returns
        -------
        list of str
            Empty if nothing differs.
        """
        differences = {
            "this result has changed": self.changed_outputs,
            "this result is gone": self.missing_outputs,
            "this input has changed since": self.changed_inputs,
            "this input is gone": self.missing_inputs,
        }
        return [f"{path}: {difference}" for difference, paths in differences.items() for path in paths]


def write_manifest(
    results: Path,
    outputs: Iterable[Path],
    inputs: Sequence[Path],
    *,
    seed: int | None = None,
    seconds: float | None = None,
) -> Path:
    """Write the manifest of a folder of results, or of a file.

    Parameters
    ----------
    results
        The folder, or the file.
    outputs
        Files and folders of results below the manifest's folder; the manifest lists them relative to it.
    inputs
        Files and folders anywhere; the manifest lists them by absolute paths. A path without a file, such as the name
        of a packaged model, is omitted.
    seed
        Seed of the rendering or of the noise; None if there is none.
    seconds
        Wall time of the computation, s; None where it is not measured.

    Returns
    -------
    Path
        The manifest.
    """
    manifest = _manifest_of(results)
    mitsuba = sys.modules.get("mitsuba")
    content = {
        "format": _FORMAT,
        "command": this_command(),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
        "mitsuba_variant": None if mitsuba is None else mitsuba.variant(),
        "seed": seed,
        "seconds": seconds,
        "inputs": {str(path): _content(path) for item in inputs for path in _files(item.resolve())},
        "outputs": {
            path.relative_to(manifest.parent).as_posix(): _content(path) for item in outputs for path in _files(item)
        },
    }
    with replacing(manifest) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return manifest


def verify(results: Path) -> Verification:
    """Compare results and their inputs with the manifest.

    Parameters
    ----------
    results
        Folder of results, or a file.

    Returns
    -------
    Verification
        Files that changed or are missing.

    Raises
    ------
    InputError
        If there is no manifest, if it has another content, or if a file that it lists cannot be read.
    """
    try:
        manifest = _manifest_of(results)
        content = read_json(manifest, _EXPECTED)
        outputs, inputs = (_entries(content, key, manifest) for key in ("outputs", "inputs"))
        if any(Path(name).is_absolute() or ".." in Path(name).parts for name in outputs):
            raise InputError(manifest, "results outside the folder", _EXPECTED)
        changed, missing = _compared({name: manifest.parent / name for name in outputs}, outputs)
        changed_inputs, missing_inputs = _compared({name: Path(name) for name in inputs}, inputs)
    except OSError as error:  # a name that is too long, a file that may not be read
        raise InputError(error.filename or results, error.strerror or str(error), "a file that can be read") from None
    return Verification(len(outputs), len(inputs), changed, missing, changed_inputs, missing_inputs)


def is_current(folder: Path, command: str) -> bool:
    """Whether a folder has unchanged results of a command, from unchanged inputs.

    Parameters
    ----------
    folder
        Folder of results.
    command
        Command as typed.

    Returns
    -------
    bool
        False also if there is no manifest.
    """
    try:
        content = read_json(folder / MANIFEST, _EXPECTED)
        return isinstance(content, dict) and content.get("command") == command and verify(folder).sound
    except InputError:
        return False


def _manifest_of(results: Path) -> Path:
    """Path of the manifest of a folder or file."""
    return results / MANIFEST if results.is_dir() else results.with_name(f"{results.name}.{MANIFEST}")


def _files(path: Path) -> list[Path]:
    """The file itself, or all files of a folder; empty for a path that does not exist."""
    return sorted(p for p in (path, *path.rglob("*")) if p.is_file())


def _content(path: Path) -> dict[str, Any]:
    """Size and hash of a file."""
    with path.open("rb") as file:
        return {"bytes": path.stat().st_size, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def _entries(content: Any, key: str, manifest: Path) -> Mapping[str, Mapping[str, Any]]:
    """Checked entries of a manifest by path."""
    sound = isinstance(content, dict) and content.get("format") == _FORMAT
    entries = content.get(key) if sound else None
    if not isinstance(entries, dict) or not all(
        isinstance(e, dict) and isinstance(e.get("sha256"), str) for e in entries.values()
    ):
        raise InputError(manifest, "other content", _EXPECTED)
    return entries


def _compared(
    paths: Mapping[str, Path], entries: Mapping[str, Mapping[str, Any]]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of files whose content differs, and of files that do not exist."""
    existing = {name: path for name, path in paths.items() if path.is_file()}
    changed = [name for name, path in existing.items() if _content(path)["sha256"] != entries[name]["sha256"]]
    return tuple(changed), tuple(name for name in paths if name not in existing)
