"""Values of a manifest that its frames' files state themselves.

A key that the manifest states stays. A key that it leaves out gets the file's value: raw files and FITS know exposure,
f-number, focal length, time, black and white level, and the mosaic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from unicodedata import normalize

from cboxlab.utils.errors import InputError

from ..frame_readers import FrameFacts, FrameHeader, frame_header
from .frames import split_name

__all__ = ["with_file_facts"]

#: Tables of frames, with the facts that they take.
_OF_TABLES: Mapping[str, tuple[str, ...]] = {
    "band": ("exposure_s", "f_number"),
    "dark": ("exposure_s",),
    "flat": ("exposure_s", "f_number"),
    "reference": ("exposure_s", "f_number"),
    "bracket": ("exposure_s", "f_number"),
}
#: Largest difference of the black levels of two files that counts as noise, DN.
_SAME_LEVEL_DN = 1.0


def _header(folder: Path, row: Any) -> FrameHeader | None:
    """Header of a table's first frame; None for a file that is faulty."""
    frames = row.get("frames") if isinstance(row, dict) else None
    if not isinstance(frames, list) or not frames or not isinstance(frames[0], str):
        return None
    try:
        path = folder / split_name(folder, frames[0])[0]
        return frame_header(path) if path.resolve().is_relative_to(folder.resolve()) and path.is_file() else None
    except (InputError, OSError, ValueError):
        return None


def _starts(facts: Sequence[FrameFacts | None]) -> list[float | None]:
    """Start of each band, s since the first; all None for incomplete or equal times."""
    times = [None if each is None else each.time for each in facts]
    moments = [time for time in times if isinstance(time, datetime)]
    if len(moments) < len(times) or len(set(moments)) < 2:
        return [None] * len(times)
    first = min(moments)
    return [(time - first).total_seconds() for time in moments]


def _on_disk(folder: Path, value: Any) -> Any:
    """A value with names of files as the folder has them: a Mac writes ü as u and two dots."""
    if isinstance(value, dict):
        changed = {key: _on_disk(folder, each) for key, each in value.items()}
        return value if all(changed[key] is value[key] for key in value) else changed
    if isinstance(value, list):
        items = [_on_disk(folder, each) for each in value]
        return value if all(a is b for a, b in zip(items, value, strict=True)) else items
    if not isinstance(value, str) or value.isascii():
        return value
    names = list[str]()
    for name in value.split("/"):
        parent = folder.joinpath(*names)
        listed = [p.name for p in parent.iterdir()] if parent.is_dir() and not (parent / name).exists() else []
        names.append(next((other for other in listed if normalize("NFC", other) == normalize("NFC", name)), name))
    path = "/".join(names)
    return value if path == value else path


def with_file_facts(folder: Path, data: dict[str, Any]) -> dict[str, Any]:
    """A manifest with the values of its frames' files for the keys that it leaves out.

    Parameters
    ----------
    folder
        Folder of the capture.
    data
        Content of the manifest as it was read, not checked yet.

    Returns
    -------
    dict
        A copy where a value was added; the same object where none was. Names of files are those on the disk, where
        letters such as ü are composed otherwise.
    """
    data = _on_disk(folder, data)
    rows = {key: data[key] for key in _OF_TABLES if isinstance(data.get(key), list)}
    headers = {key: [_header(folder, row) for row in tables] for key, tables in rows.items()}
    if not any(header is not None for of_table in headers.values() for header in of_table):
        return data
    defaults = data["defaults"] if isinstance(data.get("defaults"), dict) else {}
    filled = dict(data)
    for key, tables in rows.items():
        filled[key] = [
            row if header is None else _filled(row, header.facts, _OF_TABLES[key], defaults)
            for row, header in zip(tables, headers[key], strict=True)
        ]
    bands = filled.get("band", [])
    if all(isinstance(row, dict) and "start_s" not in row for row in bands):
        starts = _starts([None if header is None else header.facts for header in headers.get("band", [])])
        filled["band"] = [
            row if start is None else {**row, "start_s": start} for row, start in zip(bands, starts, strict=True)
        ]
    of_bands = [header for header in headers.get("band", []) if header is not None]
    return _with_camera(filled, of_bands) if of_bands and len(of_bands) == len(bands) else filled


def _filled(row: Any, facts: FrameFacts, keys: Sequence[str], defaults: Mapping[str, Any]) -> Any:
    """A table of frames with the facts of its file that neither it nor [defaults] states."""
    lacking = {key: value for key in keys if key not in row and (value := getattr(facts, key)) is not None}
    return {**row, **{key: value for key, value in lacking.items() if key not in defaults}}


def _with_camera(data: dict[str, Any], headers: Sequence[FrameHeader]) -> dict[str, Any]:
    """The manifest with camera, lens and mosaic on which all bands' files agree."""
    facts, (height, width) = headers[0].facts, headers[0].shape
    others = [header.facts for header in headers[1:]]
    white = facts.white_level
    tables: dict[str, dict[str, tuple[str, Any]]] = {
        "camera": {
            "bit_depth": ("white_level", None if white is None else int(white).bit_length()),
            "model": ("model", facts.model),
            "pixel_pitch_um": ("pixel_pitch_um", facts.pixel_pitch_um),
            "white_level_dn": ("white_level", white),
        },
        "lens": {"focal_length_mm": ("focal_length_mm", facts.focal_length_mm)},
        "mosaic": {"pattern": ("pattern", facts.pattern)},
    }
    camera = data.get("camera", {})
    if isinstance(camera, dict) and isinstance(camera.get("quantum_efficiency"), str):
        del tables["mosaic"]  # one column: a sensor without mosaic
    for name, values in tables.items():
        table = data.get(name, {})
        added = {
            key: value
            for key, (fact, value) in values.items()
            if value is not None and all(getattr(other, fact) == getattr(facts, fact) for other in others)
        }
        if name == "camera" and (level := _common_level([facts, *others])) is not None:
            added["black_level_dn"] = level
        if name == "camera":
            added |= {"width_px": width, "height_px": height}
        if added and isinstance(table, dict):
            data[name] = {**added, **table}
    return data


def _common_level(facts: Sequence[FrameFacts]) -> float | dict[str, float] | None:
    """The mean black level, one number where all channels have the same.

    From masked pixels it varies by its noise from file to file. None where files differ by more than 1 DN.
    """
    levels = [each.black_level for each in facts if each.black_level]
    if len(levels) < len(facts) or any(set(level) != set(levels[0]) for level in levels):
        return None
    by_channel = {channel: [level[channel] for level in levels] for channel in levels[0]}
    if any(max(values) - min(values) > _SAME_LEVEL_DN for values in by_channel.values()):
        return None
    means = {channel: sum(values) / len(values) for channel, values in by_channel.items()}
    different = set(means.values())
    return different.pop() if len(different) == 1 else means
