"""Folders and files that the page may name: those below one folder, and what was named when the program began."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside

__all__ = ["chosen_place", "known_places"]

#: How deep and how many are listed.
_DEPTH, _MOST = 3, 200


def chosen_place(root: Path, name: str | Path, what: str, *, new: bool = False) -> Path:
    """A folder or file by what the page names. A ``Path`` is the program's own and taken as it is.

    new : whether it may be missing. Raises InputError for a name that leaves ``root``, or is not there.
    """
    if isinstance(name, Path):
        return name
    text = name.strip()
    inside = text
    if text and Path(text).is_absolute():
        inside = os.path.relpath(text, root)
        if inside.startswith(".."):
            raise InputError(what, repr(text), f"a {what} below {root}")
    path = path_inside(root, Path(inside).as_posix() if inside else "", what)
    if not new and not path.exists():
        raise InputError(what, repr(text), f"a {what} below {root}")
    if new and path.exists() and not path.is_dir():
        raise InputError(what, f"{text!r}, a file", "a folder")
    return path


def known_places(root: Path) -> dict[str, list[str]]:
    """Captures, studies and models below a folder, relative to it, and the packaged scenes."""
    found: dict[str, list[str]] = {"captures": [], "studies": [], "models": [*packaged_scenes()]}
    for path in _files(root):
        name = path.parent.relative_to(root).as_posix()
        if path.name == "capture.toml":
            found["captures"].append(name)
        elif path.name == "study.json":
            found["studies"].append(name)
        elif path.suffix == ".toml" and _is_model(path):
            found["models"].append(path.relative_to(root).as_posix())
    return {key: values[:_MOST] for key, values in found.items()}


def _files(root: Path) -> Iterator[Path]:
    for folder, below, names in os.walk(root):
        depth = len(Path(folder).relative_to(root).parts)
        below[:] = sorted(name for name in below if not name.startswith(".")) if depth < _DEPTH else []
        yield from (Path(folder) / name for name in sorted(names) if name.endswith((".toml", "study.json")))


def _is_model(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return "model/1" in file.read(200)
    except OSError:
        return False
