"""Form for the first capture.toml of a folder of frames, with what is wrong at each field."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.capture import (
    FirstManifest,
    ManifestEntry,
    draft_manifest,
    split_name,
    write_first_manifest,
)
from cboxlab.calibration.frame_readers import read_values
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import inputs_below, read_rows
from numpy.typing import NDArray

from ...report.viewer import encoded
from .first_entries import FirstEntries, read_entries, remove_entries, store_entries
from .places import path_of_name

__all__ = ["FirstCaptures"]

#: Longer side of a small picture, px.
_THUMBNAIL_PX = 96

#: Least count that is shown white, as a part of the brightest frame's: frames without light stay dark.
_LEAST_WHITE = 0.25

#: Keys that differ from band to band; the others have one value for all bands.
_OF_EACH_BAND = ("transmittance", "start_s")

#: Tables of frames in the order of the form.
_KINDS = ("band", "bracket", "dark", "flat", "reference", "target")

#: What is found by ``draft_manifest`` where a required key is missing.
_NOTHING = "nothing"

#: Most names offered in a list.
_MAX_OFFERED = 200


class FirstCaptures:
    """Forms of folders of frames, with the entries of all tabs.

    Parameters
    ----------
    root
        Folder below which the page may open folders.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._entries: dict[Path, FirstEntries] = {}

    def draft(self, folder: str, entries: Sequence[Any], roles: Sequence[Any]) -> dict[str, Any]:
        """The form of a folder after a change of its entries.

        Parameters
        ----------
        folder
            Name of the folder of frames.
        entries, roles
            New entries, as of ``FirstEntries.changed``. They are stored unless they are refused.

        Returns
        -------
        dict
            Ready for JSON.

        Raises
        ------
        InputError
            If the folder is outside the root folder, has no frames of a scene, or has a capture.toml; for faulty roles
            and for entries of another form.
        """
        path = path_of_name(self._root, folder, "folder")
        before = self._of(path)
        after = before.changed(entries, roles)
        with inputs_below(self._root):
            text, first, _ = draft_manifest(path, (), after.roles)
            fields = _fields(first, text)
            text, first, faults = draft_manifest(path, _present(after.values, fields), after.roles)
            form = _form(path, text, first, faults, fields, after)
        self._entries[path] = after
        if after != before:
            store_entries(self._root, path, after)
        return form

    def _of(self, path: Path) -> FirstEntries:
        return self._entries[path] if path in self._entries else read_entries(self._root, path)

    def thumbnails(self, folder: str, frames: Sequence[Any]) -> dict[str, Any]:
        """Small pictures of frames.

        Parameters
        ----------
        folder
            As of ``draft``.
        frames
            Frames on one scale; empty for the first frame of each table, and for frames without a table.

        Returns
        -------
        dict
            ``thumbnails`` by the name of the frame, without frames that are written with capture.toml only. Each has
            width, height, ``values`` from 0 to 1 for the viewer, and the least and largest count of the frame.

        Raises
        ------
        InputError
            As of ``draft``, for frames that cannot be read, and for other names.
        """
        path = path_of_name(self._root, folder, "folder")
        with inputs_below(self._root):
            text, first, _ = draft_manifest(path, (), self._of(path).roles)
            in_tables = [table["frames"] for _, table in _tables(text)]
            names = dict.fromkeys(names[0] for names in in_tables)
            names |= dict.fromkeys(item.file for item in first.left_out if item.is_frame)
            if frames:
                if others := [name for name in frames if not any(name in names for names in in_tables)]:
                    raise InputError("frames", repr(others[0])[:80], "a frame of the form")
                names = dict.fromkeys(frames)
            blocks = {name: pair for name in names if (pair := _blocks(path, name)) is not None}
        whites = {name: float(np.percentile(means, 99)) for name, (means, _) in blocks.items()}
        least = (1.0 if frames else _LEAST_WHITE) * max(whites.values(), default=0.0) or 1.0
        return {"thumbnails": {name: _thumbnail(*blocks[name], max(whites[name], least)) for name in blocks}}

    def write(self, folder: str, entries: Sequence[Any], roles: Sequence[Any]) -> dict[str, Any]:
        """Write capture.toml of a folder of frames with the entries; an existing file stays.

        Parameters
        ----------
        folder, entries, roles
            As of ``draft``.

        Returns
        -------
        dict
            Path of the file.

        Raises
        ------
        InputError
            As of ``draft``, and for entries that are no values of their keys.
        """
        path = path_of_name(self._root, folder, "folder")
        after = self._of(path).changed(entries, roles)
        with inputs_below(self._root):
            text, first, _ = draft_manifest(path, (), after.roles)
            written = write_first_manifest(path, _present(after.values, _fields(first, text)), after.roles)
        self._entries.pop(path, None)
        remove_entries(self._root, path)
        return {"path": str(written.path)}


def _present(values: Sequence[ManifestEntry], fields: Sequence[Mapping[str, Any]]) -> list[ManifestEntry]:
    """Entries of fields that the form has; those of tables that another role has dissolved wait."""
    names = {(field["where"], field["key"]) for field in fields}
    return [entry for entry in values if (entry.where, entry.key) in names]


def _blocks(folder: Path, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Means of blocks of a frame, and its least and largest count; None if it has no file yet."""
    file, number = split_name(folder, name)
    if not (folder / file).is_file():
        return None
    counts = read_values(folder / file, range(number or 0, (number or 0) + 1))[0]
    block = 2 * -(-max(counts.shape) // (2 * _THUMBNAIL_PX))  # even, so that a mosaic's colours mix
    height, width = (max(size // block, 1) for size in counts.shape)
    blocks = counts[: height * block, : width * block].reshape(height, min(block, counts.shape[0]), width, -1)
    return blocks.mean(axis=(1, 3)), np.array([counts.min(), counts.max()], float)


def _thumbnail(means: NDArray[np.float64], extremes: NDArray[np.float64], white: float) -> dict[str, Any]:
    """Record of a small picture; ``white`` is the count that is shown white."""
    height, width = means.shape
    least, largest = extremes.tolist()
    values = encoded(np.clip(means / white, 0, 1))
    return {"width": width, "height": height, "values": values, "least": least, "largest": largest}


def _tables(text: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Tables of frames with their kinds."""
    tables = tomllib.loads(text)
    for kind in _KINDS:
        for table in tables.get(kind, []):
            yield kind, table


def _fields(first: FirstManifest, text: str) -> list[dict[str, Any]]:
    """Missing keys as fields of the form; those of bands for each photograph. Notes have none."""
    bands = tomllib.loads(text).get("band", [])
    fields: dict[tuple[str, str], dict[str, Any]] = {}
    for key in first.missing:
        wheres = [key.where]
        if key.where == "every [[band]]" and key.key in _OF_EACH_BAND:
            wheres = [f"[[band]] of {band['frames'][0]}" for band in bands if key.key not in band]
        for where in wheres if key.key else ():
            fields[where, key.key] = {
                "where": where,
                "key": key.key,
                "example": key.example.partition(" = ")[2],
                "why": key.why,
                "required": key.required,
            }
    return list(fields.values())


def _form(
    folder: Path,
    text: str,
    first: FirstManifest,
    faults: Sequence[InputError],
    fields: Sequence[Mapping[str, Any]],
    entries: FirstEntries,
) -> dict[str, Any]:
    """Record of the form: rows of frames, other fields, and faults that belong to no field."""
    values = {(entry.where, entry.key): entry.value for entry in entries.values}
    every = {name: {**field, "value": values.get(name, "")} for field in fields for name in [_name(field)]}
    rows: list[dict[str, Any]] = []
    row_wheres: set[str] = set()
    for kind, table in _tables(text):
        where = f"[[{kind}]] of {table['frames'][0]}"
        of_row = [] if where in row_wheres else [name for name in every if name[0] == where]
        row_wheres.add(where)
        name = str(table.get("id", table.get("band", "")))
        rows.append({"kind": kind, "name": name, "frames": table["frames"], "fields": of_row})
    rest = _distributed(faults, every, text)
    for row in rows:
        row["fields"] = [every[name] for name in row["fields"]]
    return {
        "folder": str(folder),
        "text": text,
        "rows": rows,
        "fields": [field for (where, _), field in every.items() if where not in row_wheres],
        "offered": _offered(folder),
        "notes": [{"where": key.where, "why": key.why} for key in first.missing if not key.key],
        "left_out": [{"file": item.file, "why": item.why, "is_frame": item.is_frame} for item in first.left_out],
        "lacking": sum(field["required"] and not field["value"] for field in every.values()),
        "faults": rest,
        "with_role": [role.file for role in entries.roles],
    }


def _name(field: Mapping[str, Any]) -> tuple[str, str]:
    return field["where"], field["key"]


def _distributed(
    faults: Sequence[InputError], fields: Mapping[tuple[str, str], dict[str, Any]], text: str
) -> list[str]:
    """Give each fault to the field of its key; returns the faults of no field."""
    of_key = {key: name for name in fields for key in _keys(*name, text)}
    rest = []
    for fault in faults:
        name = of_key.get(fault.where)
        if name is None:
            rest.append(str(fault))
        elif fields[name]["value"] or fault.found != _NOTHING:
            text_of_fault = f"found {fault.found}; expected {fault.expected}. {fault.hint}".strip()
            fields[name].setdefault("fault", text_of_fault)  # that of the entry comes first
    return rest


def _keys(where: str, key: str, text: str) -> Iterator[str]:
    """Keys that faults of a field name: that of an entry, and those of the manifest with it."""
    yield f"{where}: {key}"
    header, _, frame = where.removeprefix("every ").partition(" of ")
    kind = header.strip("[]")
    tables = tomllib.loads(text).get(kind)
    if isinstance(tables, list):
        for number, table in enumerate(tables):
            if not frame or table["frames"][0] == frame:
                identity = table.get("id", table.get("band"))
                yield f"{kind}[{number}]" + (f" ({identity})" if identity else "") + f".{key}"
    else:
        yield f"{kind}.{key}" if header.startswith("[") else key


def _offered(folder: Path) -> dict[str, list[str]]:
    """Names to choose from: scenes, tables, and columns of tables."""
    tables = sorted(path for path in (*folder.glob("*.csv"), *folder.glob("spectra/*.csv")) if path.is_file())
    columns: list[str] = []
    for path in tables[:_MAX_OFFERED]:
        try:
            header = read_rows(path, "a table in CSV")[:1]
        except InputError:
            continue
        columns += [
            f"{path.relative_to(folder).as_posix()}:{name.strip()}" for name in (header[0][1][1:] if header else ())
        ]
    return {
        "scene": [*packaged_scenes(), *sorted(path.name for path in folder.glob("*.toml") if path.is_file())],
        "table": [path.relative_to(folder).as_posix() for path in tables][:_MAX_OFFERED],
        "column": columns[:_MAX_OFFERED],
    }
