"""First capture.toml of a folder of frames, and the list of what the user still has to add.

No value is invented: a key that neither the files nor their names state with certainty is left out. Where the format
requires it, the capture does not load until it is there. No file is written over, and none is left out unsaid.

What the header of a file says (FITS keywords, EXIF, camera raw) comes before what its name says (see ``frame_names``).
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import parse_toml
from pydantic import BaseModel

from ..frame_readers import suffixes
from .checks import capture_faults
from .folder_frames import FolderFrame, LeftOut, convert_bands, frames_in, mosaic_of, require_one_size
from .folder_tables import FolderTables, tables_in
from .frame_classes import (
    FrameGroup,
    FrameRole,
    by_channel,
    common_values,
    corrections,
    group_frames,
    group_notes,
    require_roles,
)
from .frame_names import unread_exposure
from .manifest import (
    BandTable,
    BracketTable,
    CameraTable,
    DarkTable,
    FlatTable,
    GeometryTable,
    LampTable,
    LensTable,
    ReferenceTable,
    TargetTable,
    channel_letters,
    example_of,
)
from .manifest_faults import checked_keys, raise_faults
from .whole_manifest import Manifest

__all__ = ["FirstManifest", "ManifestEntry", "MissingKey", "draft_manifest", "write_first_manifest"]

#: By kind of table, its model.
_TABLES: dict[str, type[BaseModel]] = {
    "band": BandTable,
    "bracket": BracketTable,
    "dark": DarkTable,
    "flat": FlatTable,
    "reference": ReferenceTable,
    "target": TargetTable,
}
#: Place of the keys of no table.
_TOP = "the top, above all tables"
#: Keys that a capture may lack, and that a validation against a model takes.
_USEFUL: tuple[tuple[str, type[BaseModel], tuple[str, ...]], ...] = (
    (_TOP, Manifest, ("scene",)),
    ("[camera]", CameraTable, ("pixel_pitch_um", "gain_e_per_dn", "read_noise_e", "quantum_efficiency")),
    ("[lens]", LensTable, ("focal_length_mm", "transmittance")),
    ("every [[band]]", BandTable, ("transmittance", "f_number", "image_distance_mm", "start_s")),
    ("[lamp]", LampTable, ("radiance", "relative_uncertainty")),
    ("[geometry]", GeometryTable, ("points", "point_sigma_px")),
)
#: What is not done without frames of a kind.
_WITHOUT = (
    ("dark", "without them a dark level of 0 is assumed"),
    ("flat", "without them the lens's fall-off is nominal, and fitted with a model"),
    (
        "reference",
        'so scale = "free" claims no absolute scale; remove it if you state gain, sensor and lens instead',
    ),
)
#: What is not done without darks where the files state a black level.
_BLACK_LEVEL_ALONE = (
    "without them the files' black level is subtracted; the dark current and the hot pixels are not corrected"
)
#: Keys that say nothing where no absolute scale is claimed.
_OF_SCALE = ("image_distance_mm", "relative_uncertainty")
_FURTHER = (
    "# Keys marked 'missing' are required. Further tables: [lamp], [geometry], [labels], [crop]; see the manual,\n"
    "# 'The capture format'.\n"
)
#: Bits of usual converters, for the example of a missing bit depth.
_EXAMPLE_BITS = (12, 14, 16)


@dataclass(frozen=True)
class MissingKey:
    """A key of the manifest that is not known."""

    #: Its table.
    where: str
    #: The key with a value, as a line of TOML; empty for a note.
    example: str
    #: Meaning of the key, or what it is for.
    why: str
    #: True if the capture cannot be loaded without it.
    required: bool

    @property
    def key(self) -> str:
        """Name of the key; empty for a note."""
        return self.example.partition(" = ")[0]

    def __str__(self) -> str:
        return f"{self.where}: {self.example}   # {self.why}" if self.example else f"{self.where}: {self.why}"


@dataclass(frozen=True)
class FirstManifest(FrozenMappings):
    """A manifest that was written, and what it lacks."""

    #: The capture.toml written.
    path: Path
    #: Number of tables by kind.
    tables: Mapping[str, int]
    #: Keys to add, the required ones first.
    missing: tuple[MissingKey, ...]
    #: Files of the folder that the manifest does not name, with the reason.
    left_out: tuple[LeftOut, ...] = ()


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


@dataclass(frozen=True)
class ManifestEntry:
    """A value that the user adds to a first manifest."""

    #: Its table, as of `MissingKey`.
    where: str
    #: The key.
    key: str
    #: The value as typed; text needs no quotes.
    value: str


def draft_manifest(
    folder: Path, entries: Sequence[ManifestEntry] = (), roles: Sequence[FrameRole] = ()
) -> tuple[str, FirstManifest, list[InputError]]:
    """Text of the manifest of a folder of frames, what it lacks, and its faults.

    Parameters
    ----------
    folder
        The folder.
    entries
        Values to add.
    roles
        Kind, filter and exposure of frames that their files and names do not state, or state wrongly.

    Returns
    -------
    tuple
        Text of capture.toml, what it lacks without the entries, and its faults without its path. Nothing is written.

    Raises
    ------
    InputError
        As of ``write_first_manifest``.
    """
    folder = Path(folder)
    text, first, _ = _draft(folder, roles)
    text, refused = _with_entries(text, first, entries)
    manifest, faults = checked_keys(first.path, dict(parse_toml(first.path, text, "a manifest in TOML")))
    if manifest is not None:
        faults = capture_faults(folder, manifest)
    return text, first, [*refused, *(_in_file(first.path, fault) for fault in faults)]


def _in_file(path: Path, fault: InputError) -> InputError:
    """A fault without the file's path in its place."""
    return InputError(fault.where.removeprefix(f"{path}: "), fault.found, fault.expected, fault.hint)


def write_first_manifest(
    folder: Path, entries: Sequence[ManifestEntry] = (), roles: Sequence[FrameRole] = ()
) -> FirstManifest:
    """Classify the frames of a folder and its subfolder ``frames``; write ``capture.toml``.

    Frames stay where they are, whatever their format. Only the bands of a file with several bands are written into a
    TIFF each, in ``frames/``.

    Parameters
    ----------
    folder
        The folder.
    entries
        Values to add.
    roles
        As of ``draft_manifest``.

    Returns
    -------
    FirstManifest
        The file that was written, the keys that are missing without the entries, and the files left out.

    Raises
    ------
    InputError
        If a capture.toml exists, or if there are no frames of a scene. If frames differ in size or mosaic, or two
        photographs have one name. For files that cannot be read, for entries of unknown keys, and for roles of files
        that are no frames.
    """
    text, first, frames = _draft(folder, roles)
    text, refused = _with_entries(text, first, entries)
    raise_faults(first.path, refused)
    convert_bands(Path(folder), frames)
    with replacing(first.path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return first


def _draft(folder: Path, roles: Sequence[FrameRole]) -> tuple[str, FirstManifest, list[FolderFrame]]:
    """Text of a folder's manifest, what it lacks, and its frames."""
    folder = Path(folder)
    path = folder / "capture.toml"
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a folder of frames")
    if path.exists():
        raise InputError(path, "a file that exists already", "no such file", "Move it away to start again.")
    frames, left_out = frames_in(folder)
    if not frames:
        if left_out and all(item.file.endswith("/") for item in left_out):
            names = ", ".join(item.file for item in left_out[:4])
            hint = "Move them, or rename the subfolders."
            expected = f"frames {left_out[0].why.partition(': frames lie ')[2]}"
            raise InputError(folder, f"frames in the subfolders {names} alone", expected, hint)
        hint = "; ".join(f"{item.file}: {item.why}" for item in left_out[:3])
        raise InputError(folder, "no frames", f"files ending in {', '.join(suffixes())}", hint)
    require_one_size(frames)
    require_roles(folder, roles, frames)
    groups, unused = group_frames(frames, roles)
    pattern = mosaic_of(frames)
    letters = () if pattern is None else channel_letters(pattern)
    if not any(group.kind == "band" for group in groups):
        expected = "at least one frame that is not a dark, flat, reference or target"
        raise InputError(folder, "no frame of a scene", expected, "; ".join(f"{f.file}: {f.why}" for f in unused))
    bands = list(dict.fromkeys(str(group.band) for group in groups if group.kind == "band"))
    tables = tables_in(folder, bands, frames[0].shape, letters)
    draft = _Draft(tables, pattern)
    text = draft.text(folder, frames, groups)
    left_out = [item for item in left_out if item.file not in tables.labels.values()]
    missing = tuple(sorted(draft.missing, key=lambda key: not key.required))
    first = FirstManifest(path, dict(draft.counts), missing, (*left_out, *unused, *tables.left_out))
    return text, first, [frame for group in groups for frame in group.frames]


def _with_entries(text: str, first: FirstManifest, entries: Sequence[ManifestEntry]) -> tuple[str, list[InputError]]:
    """Text of a manifest with values added to its tables, and the faults of other values."""
    refused: list[InputError] = []
    examples = {(key.where, key.key): key.example.partition(" = ")[2] for key in first.missing if key.example}
    blocks = text.removesuffix(_FURTHER).rstrip("\n").split("\n\n")
    for entry in entries:
        header, _, frame = entry.where.removeprefix("every ").partition(" of ")
        example = examples.get((entry.where, entry.key)) or examples.get((f"every {header}", entry.key))
        if example is None:
            raise InputError(entry.where, repr(entry.key)[:80], "a key that the manifest lacks")
        try:
            line = f"{entry.key} = {_as_toml(entry, example)}"
        except InputError as fault:
            refused.append(fault)
            continue
        if entry.where.startswith("every "):
            targets = [k for k, block in enumerate(blocks) if block.startswith(header)]
        elif entry.where == _TOP:
            targets = [0]
        else:
            targets = [
                k
                for k, block in enumerate(blocks)
                if block.startswith(f"{header}\n") and (not frame or f"frames = [{_quoted(frame)}" in block)
            ] or [k for k, block in enumerate(blocks) if block == header]
        if not targets:
            blocks.append(header)
            targets = [len(blocks) - 1]
        for k in targets:
            lines = blocks[k].split("\n")
            if not any(written.startswith(f"{entry.key} =") for written in lines):
                blocks[k] = "\n".join([*(each for each in lines if not each.startswith(f"# {entry.key} =")), line])
    return "\n\n".join(_in_order_taken(blocks)) + "\n\n" + _FURTHER, refused


def _in_order_taken(blocks: Sequence[str]) -> list[str]:
    """Tables of a manifest with the bands in the order of their start times, where all have one."""
    bands = [k for k, block in enumerate(blocks) if block.startswith("[[band]]\n")]
    starts = {k: tomllib.loads(blocks[k])["band"][0].get("start_s") for k in bands}
    ordered = list(blocks)
    if None not in starts.values():
        for k, later in zip(bands, sorted(bands, key=lambda k: float(starts[k])), strict=True):
            ordered[k] = blocks[later]
    return ordered


def _as_toml(entry: ManifestEntry, example: str) -> str:
    """Value of an entry in TOML, of the type of its example."""
    value = entry.value.strip()
    if example.startswith('"'):
        return _quoted(value.strip('"'))
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{entry.where}: {entry.key}", repr(value)[:80], f"a number, such as {example}")
    return value if re.fullmatch(r"[+-]?[1-9][0-9]*|0", value) else repr(number)


class _Draft:
    """The text of a manifest in the making, with the keys that it lacks."""

    def __init__(self, tables: FolderTables, pattern: str | None) -> None:
        self.tables = tables
        self.pattern = pattern
        self._defaults: dict[str, Any] = {}
        self.missing: list[MissingKey] = []
        self.counts: Counter[str] = Counter()
        self._written: dict[str, set[str]] = defaultdict(set)

    def text(self, folder: Path, frames: Sequence[FolderFrame], groups: Sequence[FrameGroup]) -> str:
        """The whole manifest."""
        rows = [row for group in groups for row in by_channel(group, self.pattern)]
        self._defaults = common_values([group for group, _ in rows])
        self._corrected = corrections(groups)
        blocks = self._head(folder, frames, any(group.kind == "reference" for group in groups))
        bands: set[str] = set()
        for group, channel in rows:
            header = group.kind
            if group.kind == "band":
                # Of several exposures of a band, the first becomes the band and the others its brackets.
                header = "bracket" if group.band in bands else "band"
                bands.add(str(group.band))
            self.counts[header] += 1
            blocks.append(self._table(header, group, channel))
        blocks += self._further_tables()
        unfiltered = all(channel is not None for group, channel in rows if group.kind == "band")
        useless = [*(() if self.counts["reference"] else _OF_SCALE), *(("transmittance",) if unfiltered else ())]
        timed = all(group.time is not None for group, _ in rows if group.kind == "band")
        self._note_useful_keys(len(bands), {*useless, *(("start_s",) if timed else ())})
        self.missing += [MissingKey(where, "", why, False) for where, why in group_notes(groups)]
        without_kind = {kind: why for kind, why in _WITHOUT if kind[0].upper() not in self._corrected}
        if all(any((frame.facts.black_level or {}).values()) for frame in frames):
            without_kind |= {"dark": _BLACK_LEVEL_ALONE} if "dark" in without_kind else {}
        self.missing += [
            MissingKey(f"[[{kind}]]", "", f"no frames found; {without}", False)
            for kind, without in without_kind.items()
            if not self.counts[kind]
        ]
        return "\n".join(blocks) + "\n" + _FURTHER

    def _agreed(self, frames: Sequence[FolderFrame], key: str, where: str, name: str) -> Any:
        """The fact that all files which state it agree on; None, with a note, if they do not."""
        values = sorted({value for f in frames if (value := getattr(f.facts, key)) is not None})
        if len(values) > 1:
            listing = ", ".join(v if isinstance(v, str) else f"{v:g}" for v in values[:4])
            self.missing.append(MissingKey(where, "", f"{name}: the files state {listing}; a capture has one", False))
        return values[0] if len(values) == 1 else None

    def _head(self, folder: Path, frames: Sequence[FolderFrame], has_references: bool) -> list[str]:
        """The first tables, from what the files say of camera and lens."""
        height, width = frames[0].shape
        top = ['format = "capture/1"', f"name = {_quoted(folder.resolve().name)}"]
        top += [] if has_references else ['scale = "free"']
        top += [line for line in ('dark = "subtracted"', 'flat = "divided"') if line[0].upper() in self._corrected]
        camera = ["[camera]", f"width_px = {width}", f"height_px = {height}"]
        white = self._agreed(frames, "white_level", "[camera]", "white level")
        largest, zeros = max(frame.largest for frame in frames), min(frame.zero_bits for frame in frames)
        if white is not None:
            camera.append(f"bit_depth = {int(np.ceil(np.log2(max(white, largest) + 1)))}")
        else:
            why = f"bits of a count: of the camera's data sheet; the largest count found is {largest}"
            if zeros:
                why += f", and all are multiples of {2**zeros}: for {16 - zeros} bits in the upper ones of 16, it is 16"
            camera.append(f"# bit_depth =    # missing: {why}")
            bits = next(bits for bits in _EXAMPLE_BITS if largest < 2**bits and (bits == 16 or not zeros))
            self.missing.append(MissingKey("[camera]", f"bit_depth = {bits}", why, True))
        for key in ("model", "pixel_pitch_um", "gain_e_per_dn"):
            value = self._agreed(frames, key, "[camera]", key)
            if value is not None:
                camera.append(f"{key} = {_quoted(value) if isinstance(value, str) else repr(value)}")
        self._agreed(frames, "iso", "[camera]", "ISO")
        lens = ["[lens]"]
        focal = self._agreed(frames, "focal_length_mm", "[lens]", "focal_length_mm")
        lens += [] if focal is None else [f"focal_length_mm = {focal!r}"]
        pattern, columns = self.pattern, self.tables.columns
        if pattern is not None and self.tables.channels:
            listing = ", ".join(f"{letter} = {_quoted(column)}" for letter, column in self.tables.channels.items())
            camera.append(f"quantum_efficiency = {{{listing}}}")
        elif "quantum_efficiency" in columns and pattern is None:
            camera.append(f"quantum_efficiency = {_quoted(columns['quantum_efficiency'])}")
        if "lens" in columns:
            lens.append(f"transmittance = {_quoted(columns['lens'])}")
        mosaic = [] if pattern is None else ["[mosaic]", f"pattern = {_quoted(pattern)}"]
        self._note_lines("[camera]", camera)
        self._note_lines("[lens]", lens)
        defaults = [f"{key} = {value!r}" for key, value in self._defaults.items()]
        blocks = [top, camera, mosaic, lens, ["[defaults]", *defaults] if defaults else []]
        return ["\n".join(lines) + "\n" for lines in blocks if lines]

    def _table(self, header: str, group: FrameGroup, channel: str | None) -> str:
        """One table of frames; a required key that is not known stands in it as a comment."""
        lines = [] if group.band is None else [f"{'id' if header == 'band' else 'band'} = {_quoted(group.band)}"]
        lines.append(f"frames = [{', '.join(_quoted(frame.listed) for frame in group.frames)}]")
        if header == "band" and channel is not None:
            lines.append(f"channel = {_quoted(channel)}")
        if group.exposure_s is not None and header != "target" and "exposure_s" not in self._defaults:
            lines.append(f"exposure_s = {group.exposure_s!r}")
        if group.f_number is not None and header not in ("dark", "target") and "f_number" not in self._defaults:
            lines.append(f"f_number = {group.f_number!r}")
        if header == "band" and group.band in self.tables.filters:
            lines.append(f"transmittance = {_quoted(self.tables.filters[group.band])}")
        if header in ("reference", "flat") and header in self.tables.columns:
            lines.append(f"radiance = {_quoted(self.tables.columns[header])}")
        keys = {line.partition(" = ")[0] for line in lines} | set(self._defaults)
        where = f"[[{header}]] of {group.frames[0].listed}"
        for key, field in _TABLES[header].model_fields.items():
            if field.is_required() and key not in keys:
                why = field.description or ""
                unread = unread_exposure(group.frames[0].stem) if key == "exposure_s" else None
                why += "" if unread is None else f"; '{unread}' in the name may be it, which is not certain"
                self.missing.append(MissingKey(where, example_of(_TABLES[header], key), why, True))
                lines.append(f"# {key} =    # missing: {why}")
        if header == "band":
            for key in keys:
                self._written[f"[[band]] {key}"].add(str(group.band))
        return "\n".join([f"[[{header}]]", *lines]) + "\n"

    def _further_tables(self) -> list[str]:
        """[lamp], [geometry] and [labels] by the tables of the folder."""
        blocks = []
        if "lamp" in self.tables.columns:
            blocks.append(["[lamp]", f"radiance = {_quoted(self.tables.columns['lamp'])}"])
        if self.tables.points is not None:
            blocks.append(["[geometry]", f"points = {_quoted(self.tables.points)}"])
        if self.tables.labels:
            blocks.append(["[labels]", *(f"{key} = {_quoted(file)}" for key, file in self.tables.labels.items())])
        for lines in blocks:
            self._note_lines(lines[0], lines)
        return ["\n".join(lines) + "\n" for lines in blocks]

    def _note_lines(self, table: str, lines: Sequence[str]) -> None:
        self._written[table].update(line.partition(" = ")[0] for line in lines)

    def _note_useful_keys(self, bands: int, useless: Collection[str]) -> None:
        """Note optional keys that are not written; those of a band, if any band lacks them.

        Keys in ``useless`` are not noted for frames and lamp: the files state them, or nothing uses them.
        """
        for where, table, keys in _USEFUL:
            for key in keys:
                in_bands = len(self._written[f"[[band]] {key}"]) == bands if table is BandTable else False
                if not in_bands and key not in self._written[where] and not (table is not LensTable and key in useless):
                    description = table.model_fields[key].description or ""
                    self.missing.append(MissingKey(where, example_of(table, key), description, False))
