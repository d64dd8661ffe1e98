"""First capture.toml of a folder of frames, with what the user enters in the page."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
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
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import inputs_below
from numpy.typing import NDArray

from ...report.viewer import encoded
from .places import path_of_name

__all__ = ["first_draft", "first_thumbnails", "write_first"]

#: Longer side of a small picture, px.
_THUMBNAIL_PX = 96

#: Least count that is shown white, as a part of the brightest frame's: frames without light stay dark.
_LEAST_WHITE = 0.25

#: Most characters of a value.
_MAX_LENGTH = 300

#: Texts of an entry: where, key and value.
_PARTS = 3

#: Keys that differ from band to band; the others have one value for all bands.
_OF_EACH_BAND = ("transmittance", "start_s")


def first_draft(root: Path, folder: str, entries: Sequence[Any]) -> dict[str, Any]:
    """Recognised frames of a folder, missing keys, and faults with the entries so far.

    Parameters
    ----------
    root
        Folder below which the page may open folders.
    folder
        Name of the folder of frames.
    entries
        Records with ``where``, ``key`` and ``value``.

    Returns
    -------
    dict
        Ready for JSON.

    Raises
    ------
    InputError
        If the folder is outside the root folder, has no frames, or has a capture.toml; for faulty entries.
    """
    path = path_of_name(root, folder, "folder")
    with inputs_below(root):
        text, first, faults = draft_manifest(path, _entries(entries))
    tables = tomllib.loads(text)
    recognised = [
        {"kind": kind, "name": str(table.get("id", table.get("band", ""))), "frames": table["frames"]}
        for kind in first.tables
        for table in tables.get(kind, [])
    ]
    return {
        "folder": str(path),
        "text": text,
        "recognised": recognised,
        "missing": _fields(first, tables),
        "left_out": [{"file": item.file, "why": item.why} for item in first.left_out],
        "faults": faults,
    }


def first_thumbnails(root: Path, folder: str) -> dict[str, Any]:
    """Small pictures of the first frame of each kind, filter or target in a folder of frames.

    Parameters
    ----------
    root, folder
        As of ``first_draft``.

    Returns
    -------
    dict
        The list ``thumbnails`` in the order of ``recognised`` in ``first_draft``. An entry is null for a frame that is
        written with capture.toml only. Others have width, height, ``values`` from 0 to 1 for the viewer, and the least
        and largest count of the frame.

    Raises
    ------
    InputError
        As of ``first_draft``, and for frames that cannot be read.
    """
    path = path_of_name(root, folder, "folder")
    with inputs_below(root):
        text, first, _ = draft_manifest(path)
        tables = tomllib.loads(text)
        names = [table["frames"][0] for kind in first.tables for table in tables.get(kind, [])]
        blocks = [_blocks(path, name) for name in names]
    whites = [0.0 if each is None else float(np.percentile(each[0], 99)) for each in blocks]
    least = _LEAST_WHITE * max(whites, default=0.0) or 1.0
    pairs = zip(blocks, whites, strict=True)
    return {"thumbnails": [None if each is None else _thumbnail(*each, max(white, least)) for each, white in pairs]}


def _blocks(folder: Path, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Means of blocks of a frame, and its least and largest count; None if it has no file yet."""
    file, number = split_name(folder, name)
    if not (folder / file).is_file():
        return None
    counts = read_values(folder / file, range(number or 0, (number or 0) + 1))[0]
    block = -(-max(counts.shape) // _THUMBNAIL_PX)
    height, width = (max(size // block, 1) for size in counts.shape)
    blocks = counts[: height * block, : width * block].reshape(height, min(block, counts.shape[0]), width, -1)
    return blocks.mean(axis=(1, 3)), np.array([counts.min(), counts.max()], float)


def _thumbnail(means: NDArray[np.float64], extremes: NDArray[np.float64], white: float) -> dict[str, Any]:
    """Record of a small picture; ``white`` is the count that is shown white."""
    height, width = means.shape
    least, largest = extremes.tolist()
    values = encoded(np.clip(means / white, 0, 1))
    return {"width": width, "height": height, "values": values, "least": least, "largest": largest}


def write_first(root: Path, folder: str, entries: Sequence[Any]) -> dict[str, Any]:
    """Write capture.toml of a folder of frames with the entries; an existing file stays.

    Parameters
    ----------
    root, folder, entries
        As of ``first_draft``.

    Returns
    -------
    dict
        Path of the file.

    Raises
    ------
    InputError
        As of ``first_draft``.
    """
    path = path_of_name(root, folder, "folder")
    with inputs_below(root):
        return {"path": str(write_first_manifest(path, _entries(entries)).path)}


def _entries(records: Sequence[Any]) -> list[ManifestEntry]:
    """Entries of the page; those without a value are left out."""
    entries = []
    for record in records:
        values = [record.get(key) for key in ("where", "key", "value")] if isinstance(record, Mapping) else []
        texts = [text for text in values if isinstance(text, str) and len(text) <= _MAX_LENGTH]
        if len(texts) != _PARTS:
            raise InputError("entries", repr(record)[:80], "records with where, key and value")
        if texts[2].strip():
            entries.append(ManifestEntry(*texts))
    return entries


def _fields(first: FirstManifest, tables: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Missing keys as fields of the form, those of each band once a band; notes have no key."""
    fields = []
    for key in first.missing:
        tables_lacking = [key.where]
        if key.where == "every [[band]]" and key.key in _OF_EACH_BAND:
            tables_lacking = [f"[[band]] of {band['frames'][0]}" for band in tables["band"] if key.key not in band]
        fields += [
            {
                "where": where,
                "key": key.key,
                "example": key.example.partition(" = ")[2],
                "why": key.why,
                "required": key.required,
            }
            for where in tables_lacking
        ]
    return fields
