"""Unsaved studies in a hidden folder below the workbench's, offered again after a crash."""

from __future__ import annotations

import hashlib
import logging
import shutil
from pathlib import Path

from ...api import Study

__all__ = ["AUTOSAVE_FOLDER", "autosave", "discard_autosave", "unsaved_studies"]

#: Folder of unsaved studies, below the root folder. Lists of captures and studies leave hidden folders out.
AUTOSAVE_FOLDER = ".cbox-unsaved"

_LOG = logging.getLogger(__name__)


def _folder(root: Path, study: Study) -> Path:
    """Folder of the unsaved work on the captures of a study."""
    captures = [str(capture.folder.resolve()) for capture in study.captures]
    digest = hashlib.sha256("\n".join(captures).encode()).hexdigest()[:8]
    return root / AUTOSAVE_FOLDER / f"{study.captures[0].folder.name[:60]}-{digest}"


def autosave(root: Path, study: Study) -> None:
    """Write a study to its folder of unsaved work; a disk that refuses it is logged.

    Parameters
    ----------
    root
        Folder of the workbench.
    study
        The study.
    """
    try:
        study.write(_folder(root, study))
    except OSError as error:
        _LOG.warning("unsaved work is not stored: %s", error)


def discard_autosave(root: Path, study: Study) -> None:
    """Remove the unsaved work on the captures of a study.

    Parameters
    ----------
    root
        Folder of the workbench.
    study
        The study, which is saved elsewhere.
    """
    shutil.rmtree(_folder(root, study), ignore_errors=True)


def unsaved_studies(root: Path) -> list[str]:
    """Studies with unsaved work, the newest first.

    Parameters
    ----------
    root
        Folder of the workbench.

    Returns
    -------
    list of str
        Paths relative to ``root``.
    """
    files = sorted((root / AUTOSAVE_FOLDER).glob("*/study.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    return [path.parent.relative_to(root).as_posix() for path in files]
