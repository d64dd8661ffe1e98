"""Unsaved studies in a hidden folder below the workbench's, offered again after a crash."""

from __future__ import annotations

import logging
import shutil
from itertools import count
from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError

from ...api import Study

__all__ = ["AUTOSAVE_FOLDER", "autosave", "discard_autosave", "discard_unsaved", "unsaved_studies"]

#: Folder of unsaved studies, below the root folder. Lists of captures and studies leave hidden folders out.
AUTOSAVE_FOLDER = ".cbox-unsaved"

#: Largest number of characters of a capture's name in the name of a folder.
_MAX_NAME = 60

_LOG = logging.getLogger(__name__)


def autosave(root: Path, study: Study, folder: Path | None) -> Path | None:
    """Write a study to its folder of unsaved work; a disk that refuses it is logged.

    Parameters
    ----------
    root
        Folder of the workbench.
    study
        The study.
    folder
        Folder in which it was written before; None for a new one.

    Returns
    -------
    Path | None
        Folder of the study; None if the disk refused it.
    """
    try:
        folder = _new_folder(root, study) if folder is None else folder
        study.write(folder)
    except OSError as error:
        _LOG.warning("unsaved work is not stored: %s", error)
    return folder


def _new_folder(root: Path, study: Study) -> Path:
    """Empty folder of a new name, so that no study replaces another one."""
    parent, name = root / AUTOSAVE_FOLDER, study.captures[0].folder.resolve().name[:_MAX_NAME]
    if parent.is_symlink():
        raise OSError(f"{parent} is a link, which may lead anywhere")
    parent.mkdir(exist_ok=True)
    for number in count(1):
        try:
            (parent / f"{name}-{number}").mkdir()
        except FileExistsError:
            continue
        return parent / f"{name}-{number}"
    raise AssertionError("no end")


def discard_autosave(folder: Path | None) -> None:
    """Remove the unsaved work of a study.

    Parameters
    ----------
    folder
        Folder of ``autosave``; None for none.
    """
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def discard_unsaved(root: Path, name: str) -> None:
    """Remove unsaved work that the list of ``unsaved_studies`` has.

    Parameters
    ----------
    root
        Folder of the workbench.
    name
        Path of the list.

    Raises
    ------
    InputError
        For another name.
    """
    if name not in [each["path"] for each in unsaved_studies(root)]:
        raise InputError("unsaved work", repr(name)[:80], "a name of the list")
    discard_autosave(root / name)


def unsaved_studies(root: Path) -> list[dict[str, Any]]:
    """Studies with unsaved work, the newest first; links, which may lead anywhere, are left out.

    Parameters
    ----------
    root
        Folder of the workbench.

    Returns
    -------
    list of dict
        Path relative to ``root``, the capture's ``name``, and when it ``changed``, seconds since 1970.
    """
    folder = root / AUTOSAVE_FOLDER
    paths = [] if folder.is_symlink() else folder.glob("*/study.json")
    files = [(path, path.stat().st_mtime) for path in paths if not path.parent.is_symlink() and path.is_file()]
    return [
        {
            "path": path.parent.relative_to(root).as_posix(),
            "name": path.parent.name.rpartition("-")[0],
            "changed": changed,
        }
        for path, changed in sorted(files, key=lambda each: each[1], reverse=True)
    ]
