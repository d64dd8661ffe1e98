"""Folders and files that the page may open: those below one folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside

from .autosave import unsaved_studies

__all__ = ["list_inputs", "path_of_name", "require_study_folder"]

#: Levels of folders that are listed below the root.
_MAX_DEPTH = 3
#: Largest number of captures, studies or models that are listed.
_MAX_LISTED = 200


def path_of_name(root: Path, name: str | Path, what: str, *, new: bool = False) -> Path:
    """Path of a folder or file that the page names.

    Parameters
    ----------
    root
        Folder below which the page may open and save files.
    name
        Name, relative to ``root`` or absolute. A ``Path`` comes from the program and is returned unchecked.
    what
        Kind of the file or folder, for messages: "capture", "model", "effect" or "folder".
    new
        Whether it may be missing.

    Returns
    -------
    Path
        The checked path.

    Raises
    ------
    InputError
        If the name leaves ``root``, or does not exist.
    """
    if isinstance(name, Path):
        return name
    text = name.strip()
    inside, expected = text, f"{'an' if what.startswith('e') else 'a'} {what} below {root}"
    if text and Path(text).is_absolute():
        inside = os.path.relpath(text, root)
        if inside.startswith(".."):
            raise InputError(what, repr(text), expected)
    path = path_inside(root, Path(inside).as_posix() if inside else "", what)
    try:
        exists, is_folder = path.exists(), path.is_dir()
    except OSError as error:
        raise InputError(what, f"{text[:80]!r} ({error.strerror})", expected) from None
    if not new and not exists:
        raise InputError(what, repr(text), expected)
    if new and exists and not is_folder:
        raise InputError(what, f"{text!r}, a file", "a folder")
    return path


def require_study_folder(root: Path, folder: Path) -> None:
    """Require that a study may be saved in a folder, without replacing anything but a study.

    Parameters
    ----------
    root
        Folder below which the page may save files.
    folder
        The folder, below ``root``; it need not exist.

    Raises
    ------
    InputError
        If it is in the folder of a capture, contains files but no study, or folders that are links.
    """
    for parent in (folder, *folder.parents):
        if (parent / "capture.toml").exists():
            raise InputError("folder", f"'{folder}', in the folder of a capture", "a folder outside it")
        if parent == root:
            break
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "study.json").exists():
        hint = "Choose another name."
        raise InputError("folder", f"'{folder}', with files of other kinds", "a new folder, or a saved study's", hint)
    for path, names, _ in os.walk(folder):
        for link in (Path(path) / name for name in names if (Path(path) / name).is_symlink()):
            raise InputError("folder", f"'{link}', a link to a folder", "a study's own folders", "Remove the link.")


def list_inputs(root: Path) -> dict[str, Any]:
    """Captures, studies and models below a folder, and the packaged scenes.

    Parameters
    ----------
    root
        The folder.

    Returns
    -------
    dict
        Lists ``captures``, ``studies`` and ``models`` of paths relative to the folder, and ``unsaved`` as of
        ``unsaved_studies``.
    """
    names: dict[str, list[str]] = {"captures": [], "studies": [], "models": [*packaged_scenes()]}
    for path in _files(root):
        name = path.parent.relative_to(root).as_posix()
        if path.name == "capture.toml":
            names["captures"].append(name)
        elif path.name == "study.json":
            names["studies"].append(name)
        elif path.suffix == ".toml" and _is_model(path):
            names["models"].append(path.relative_to(root).as_posix())
    return {"unsaved": unsaved_studies(root), **{key: values[:_MAX_LISTED] for key, values in names.items()}}


def _files(root: Path) -> Iterator[Path]:
    """Files to open below a folder, without hidden folders, pipes and links out of it."""
    resolved = root.resolve()
    for folder, below, file_names in os.walk(root):
        depth = len(Path(folder).relative_to(root).parts)
        below[:] = sorted(name for name in below if not name.startswith(".")) if depth < _MAX_DEPTH else []
        paths = [Path(folder) / name for name in sorted(file_names) if name.endswith((".toml", "study.json"))]
        yield from (path for path in paths if path.is_file() and path.resolve().is_relative_to(resolved))


def _is_model(path: Path) -> bool:
    """Whether a file states the format of models; False if it cannot be read."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return "model/1" in file.read(200)
    except OSError:
        return False
