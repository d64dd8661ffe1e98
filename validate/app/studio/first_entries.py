"""Entries for a first manifest, in a hidden file until capture.toml is written."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.calibration.capture import FrameRole, ManifestEntry
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing

from .autosave import AUTOSAVE_FOLDER

__all__ = ["FirstEntries", "read_entries", "remove_entries", "store_entries"]

#: Most characters of a value.
_MAX_LENGTH = 300
#: Most entries, and most frames with a role: as many as no folder has.
_MAX_ENTRIES = 10_000
#: Longest file of entries that is read, bytes.
_MAX_FILE = 1 << 23

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class FirstEntries:
    """Values of keys, and roles of frames, each the last one that was entered."""

    #: Values of keys.
    values: tuple[ManifestEntry, ...] = ()
    #: Roles of frames.
    roles: tuple[FrameRole, ...] = ()

    def changed(self, entries: Sequence[Any], roles: Sequence[Any]) -> FirstEntries:
        """These entries with later ones; an empty value and an empty kind remove one.

        Parameters
        ----------
        entries
            Records with ``where``, ``key`` and ``value``.
        roles
            Records with ``file``, ``kind``, ``filter`` and ``exposure_s``, all texts.

        Returns
        -------
        FirstEntries
            The entries after the change.

        Raises
        ------
        InputError
            For records of another form.
        """
        values = {(entry.where, entry.key): entry for entry in self.values}
        for record in entries:
            where, key, value = _texts(record, ("where", "key", "value"))
            values[where, key] = ManifestEntry(where, key, value)
        of_files = {role.file: role for role in self.roles}
        for record in roles:
            file, kind, filter_, exposure = _texts(record, ("file", "kind", "filter", "exposure_s"))
            of_files[file] = FrameRole(file, kind, filter_.strip(), _seconds(file, exposure))
        if max(len(values), len(of_files)) > _MAX_ENTRIES:
            raise InputError("entries", f"{max(len(values), len(of_files))} entries", f"at most {_MAX_ENTRIES}")
        return FirstEntries(
            tuple(entry for entry in values.values() if entry.value.strip()),
            tuple(role for role in of_files.values() if role.kind),
        )

    @property
    def record(self) -> dict[str, Any]:
        """Ready for JSON, and for ``changed``."""
        return {
            "entries": [{"where": e.where, "key": e.key, "value": e.value} for e in self.values],
            "roles": [
                {
                    "file": role.file,
                    "kind": role.kind,
                    "filter": role.filter,
                    "exposure_s": "" if role.exposure_s is None else repr(role.exposure_s),
                }
                for role in self.roles
            ],
        }


def _texts(record: Any, keys: Sequence[str]) -> list[str]:
    values = [record.get(key) for key in keys] if isinstance(record, Mapping) else []
    texts = [text for text in values if isinstance(text, str) and len(text) <= _MAX_LENGTH]
    if len(texts) != len(keys):
        raise InputError("entries", repr(record)[:80], f"records with the texts {', '.join(keys)}")
    return texts


def _seconds(file: str, text: str) -> float | None:
    if not text.strip():
        return None
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        raise InputError(f"{file[:80]}: exposure", repr(text)[:80], "seconds, such as 4.0") from None


def _path(root: Path, folder: Path) -> Path | None:
    """File of the entries of a folder; None behind a link, which may lead anywhere."""
    name = hashlib.sha256(folder.resolve().as_posix().encode("utf-8", "surrogateescape")).hexdigest()[:16]
    parent = root / AUTOSAVE_FOLDER
    path = parent / f"first-capture-{name}.json"
    return None if parent.is_symlink() or path.is_symlink() else path


def read_entries(root: Path, folder: Path) -> FirstEntries:
    """Stored entries of a folder of frames.

    Parameters
    ----------
    root
        Folder of the workbench.
    folder
        The folder of frames.

    Returns
    -------
    FirstEntries
        Without entries where none are stored, or where the file is damaged.
    """
    path = _path(root, folder)
    try:
        if path is None or not path.is_file() or path.stat().st_size > _MAX_FILE:
            return FirstEntries()
        record = json.loads(path.read_text(encoding="utf-8"))
        return FirstEntries().changed(record["entries"], record["roles"])
    except (OSError, ValueError, RecursionError, TypeError, KeyError) as error:
        _LOG.warning("stored entries are not read: %s: %s", path, error)
        return FirstEntries()


def store_entries(root: Path, folder: Path, entries: FirstEntries) -> None:
    """Store entries in a hidden file; a disk that refuses it is logged.

    Parameters
    ----------
    root
        Folder of the workbench.
    folder
        The folder of frames.
    entries
        The entries.
    """
    path = _path(root, folder)
    try:
        if path is None:
            raise OSError(f"{root / AUTOSAVE_FOLDER} is a link, which may lead anywhere")
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps({"folder": str(folder), **entries.record}), encoding="utf-8")
    except OSError as error:
        _LOG.warning("entries are not stored: %s", error)


def remove_entries(root: Path, folder: Path) -> None:
    """Remove stored entries, once capture.toml is written.

    Parameters
    ----------
    root
        Folder of the workbench.
    folder
        The folder of frames.
    """
    path = _path(root, folder)
    if path is not None:
        path.unlink(missing_ok=True)
