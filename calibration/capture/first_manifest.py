"""Writes a first capture.toml for a folder of frames and lists what the user still has to add.

No value is invented: a key that neither the files nor their names tell is left out. Where the format requires it, the
capture does not load until it is there.

The kind, exposure, f-number and filter of a frame are taken from the file's metadata, else from its name:
``dark``, ``flat``, ``sphere`` or ``reference``, a filter such as ``f550`` or ``550nm``, an exposure such as ``4s``
or ``250ms``, and a last number that counts repeats.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import OwnMappings
from pydantic import BaseModel

from .foreign_frames import SUFFIXES, ForeignFrame, read_foreign
from .manifest import (
    BandTable,
    BracketTable,
    CameraTable,
    DarkTable,
    FlatTable,
    GeometryTable,
    LampTable,
    LensTable,
    Manifest,
    ReferenceTable,
    TargetTable,
    example_of,
)

__all__ = ["FirstManifest", "MissingKey", "write_first_manifest"]

_KINDS = {
    "dark": ("dark", "bias"),
    "flat": ("flat",),
    "reference": ("sphere", "reference", "integrating"),
    "target": ("target", "chessboard", "charuco", "checkerboard"),
}
_TABLES: dict[str, type[BaseModel]] = {
    "band": BandTable,
    "bracket": BracketTable,
    "dark": DarkTable,
    "flat": FlatTable,
    "reference": ReferenceTable,
    "target": TargetTable,
}
#: Keys that a capture may lack, and that a validation against a model takes.
_USEFUL: tuple[tuple[str, type[BaseModel], tuple[str, ...]], ...] = (
    ("[camera]", CameraTable, ("pixel_pitch_um", "gain_e_per_dn", "read_noise_e", "quantum_efficiency")),
    ("[lens]", LensTable, ("focal_length_mm", "transmittance")),
    ("every [[band]]", BandTable, ("transmittance", "f_number", "image_distance_mm", "start_s")),
    ("[lamp]", LampTable, ("radiance", "relative_uncertainty")),
    ("[geometry]", GeometryTable, ("points", "point_sigma_px")),
    ("the top, above all tables", Manifest, ("scene",)),
)
#: What is not done without frames of a kind.
_WITHOUT = (
    ("dark", "without them a dark level of 0 is assumed"),
    ("flat", "without them vignetting is not corrected"),
    ("reference", "without them the absolute scale is the nominal lens's"),
)
_FURTHER = (
    "# Keys marked 'missing' are required. Further tables: [lamp], [geometry], [labels], [crop]; see the manual,\n"
    "# 'The capture format'.\n"
)
_BAND = re.compile(r"(?:^|[^a-z0-9])(?:f|nm|band)?(\d{3,4})(?:nm)?(?=$|[^0-9a-z])")
_EXPOSURE = re.compile(r"(?:^|[^a-z0-9.])(\d+(?:[._]\d+)?)(ms|s|sec)(?=$|[^a-z])")


@dataclass(frozen=True)
class MissingKey:
    """A key that is not known. where : its table. example : a line of TOML. why : what it is, or what it is for.

    required : whether the capture cannot be loaded without it.
    """

    where: str
    example: str
    why: str
    required: bool

    def __str__(self) -> str:
        return f"{self.where}: {self.example}   # {self.why}" if self.example else f"{self.where}: {self.why}"


@dataclass(frozen=True)
class FirstManifest(OwnMappings):
    """path : the capture.toml written. tables : number of tables by kind. missing : keys to add, the required first."""

    path: Path
    tables: Mapping[str, int]
    missing: tuple[MissingKey, ...]


@dataclass(frozen=True)
class _ClassifiedFrame:
    kind: str
    band: str | None
    exposure_s: float | None
    f_number: float | None
    frame: ForeignFrame


def _kind(frame: ForeignFrame) -> str:
    stated = f"{frame.metadata.get('kind', '')} {frame.name}".lower()
    return next((k for k, words in _KINDS.items() if any(word in stated for word in words)), "band")


def _band(frame: ForeignFrame) -> str | None:
    stated = str(frame.metadata.get("filter", "")).strip()
    if stated:
        return re.sub(r"\s+", "-", stated)
    found = _BAND.search(frame.name.lower())
    return f"f{found.group(1)}" if found else None


def _exposure(frame: ForeignFrame) -> float | None:
    if "exposure_s" in frame.metadata:
        return float(frame.metadata["exposure_s"])
    found = _EXPOSURE.search(frame.name.lower())
    if found is None:
        return None
    value = float(found.group(1).replace("_", "."))
    return value / 1000 if found.group(2) == "ms" else value


def _classified(frame: ForeignFrame) -> _ClassifiedFrame:
    kind = _kind(frame)
    band = None if kind in ("dark", "target") else _band(frame)
    if kind == "band" and band is None:
        # Without a filter, frames that differ in name (without the repeat number) are different bands.
        band = re.sub(r"[-_ ]*\d+$", "", frame.name) or "all"
    f_number = None if kind in ("dark", "target") else frame.metadata.get("f_number")
    return _ClassifiedFrame(kind, band, _exposure(frame), f_number, frame)


def _common(frames: Sequence[ForeignFrame], key: str) -> Any:
    values = Counter(f.metadata[key] for f in frames if key in f.metadata)
    return values.most_common(1)[0][0] if values else None


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _group(frames: Iterable[_ClassifiedFrame]) -> dict[tuple[Any, ...], list[_ClassifiedFrame]]:
    groups: dict[tuple[Any, ...], list[_ClassifiedFrame]] = {}
    for one in frames:
        groups.setdefault((one.kind, one.band, one.exposure_s, one.f_number), []).append(one)
    return groups


def _table(
    header: str,
    lines: list[str],
    group: Sequence[_ClassifiedFrame],
    paths: dict[int, str],
    missing: list[MissingKey],
) -> str:
    """One table of the manifest; a required key that is not known stands in it as a comment."""
    listed = ", ".join(_quoted(paths[id(one.frame)]) for one in group)
    table, exposure, f_number = _TABLES[header], group[0].exposure_s, group[0].f_number
    known = [*lines, f"frames = [{listed}]"]
    if exposure is not None and header != "target":
        known.append(f"exposure_s = {exposure:g}")
    if f_number is not None and header not in ("dark", "target"):
        known.append(f"f_number = {f_number:g}")
    stated = {line.partition(" = ")[0] for line in known}
    where = f"[[{header}]] of {paths[id(group[0].frame)]}"
    for key, field in table.model_fields.items():
        if field.is_required() and key not in stated:
            missing.append(MissingKey(where, example_of(table, key), field.description or "", True))
            known.append(f"# {key} =    # missing: {field.description}")
    return "\n".join([f"[[{header}]]", *known]) + "\n"


def write_first_manifest(folder: Path) -> FirstManifest:
    """Classify the frames of a folder (and of its subfolder ``frames``) and write ``capture.toml``.

    Frames in other formats are converted to 16-bit TIFF in ``frames/``; TIFFs stay where they are.
    Raises InputError if a capture.toml exists, if there are no frames of a scene, if frames differ in size, and
    for files that cannot be read.
    """
    folder = Path(folder)
    path = folder / "capture.toml"
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a folder of frames")
    if path.exists():
        raise InputError(path, "a file that exists already", "no such file", "Move it away to start again.")
    files = sorted(
        p
        for place in (folder, folder / "frames")
        if place.is_dir()
        for p in place.iterdir()
        if p.suffix.lower() in SUFFIXES
    )
    frames = [frame for file in files for frame in read_foreign(file)]
    if not frames:
        raise InputError(folder, "no frames", f"files ending in {', '.join(SUFFIXES)}")
    sizes = Counter(frame.counts.shape for frame in frames)
    if len(sizes) > 1:
        common = sizes.most_common(1)[0][0]
        odd = next(frame for frame in frames if frame.counts.shape != common)
        raise InputError(
            odd.path,
            f"{odd.counts.shape[1]} x {odd.counts.shape[0]} px",
            f"{common[1]} x {common[0]} px like the other frames",
        )
    paths = {}
    for frame in frames:
        if frame.path.suffix.lower() in (".tif", ".tiff"):
            paths[id(frame)] = frame.path.relative_to(folder).as_posix()
            continue
        paths[id(frame)] = f"frames/{frame.name}.tif"
        with replacing(folder / "frames" / f"{frame.name}.tif") as temporary:
            tifffile.imwrite(temporary, frame.counts, photometric="minisblack", metadata=None)
    text, tables, missing = _manifest(folder, frames, paths)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return FirstManifest(path, tables, tuple(missing))


def _manifest(
    folder: Path, frames: list[ForeignFrame], paths: dict[int, str]
) -> tuple[str, dict[str, int], list[MissingKey]]:
    missing: list[MissingKey] = []
    blocks, tables = [_head(folder, frames, missing)], Counter[str]()
    groups = _group(_classified(frame) for frame in frames)
    scenes = {band for kind, band, *_ in groups if kind == "band"}
    seen: set[str] = set()
    for (kind, band, *_), group in sorted(groups.items(), key=lambda item: str(item[0])):
        first = paths[id(group[0].frame)]
        header, lines = kind, [] if band is None else [f"band = {_quoted(band)}"]
        if kind == "band":
            # Of several exposures of a band, the first becomes the band and the others its brackets.
            header = "bracket" if band in seen else "band"
            lines = lines if header == "bracket" else [f"id = {_quoted(str(band))}"]
            seen.add(str(band))
        elif kind in ("flat", "reference") and band is not None and band not in scenes:
            missing.append(
                MissingKey(f"[[{kind}]]", "", f"{first} left out: its band has no frames of the scene", False)
            )
            continue
        tables[header] += 1
        blocks.append(_table(header, lines, group, paths, missing))
    if not tables["band"]:
        expected = "at least one frame that is not a dark, flat, reference or target"
        raise InputError(folder, "no frame of a scene", expected)
    missing += [
        MissingKey(f"[[{kind}]]", "", f"no frames found; {without}", False)
        for kind, without in _WITHOUT
        if not tables[kind]
    ]
    text = "\n".join(blocks) + "\n" + _FURTHER
    return text, dict(tables), sorted(missing, key=lambda key: not key.required)


def _head(folder: Path, frames: list[ForeignFrame], missing: list[MissingKey]) -> str:
    """The manifest's first tables, from what the frames' files say of camera and lens."""
    height, width = frames[0].counts.shape
    head = [
        'format = "capture/1"',
        f"name = {_quoted(folder.resolve().name)}",
        "",
        "[camera]",
        f"width_px = {width}",
        f"height_px = {height}",
    ]
    white, largest = _common(frames, "white_level"), max(int(f.counts.max()) for f in frames)
    if white is not None:
        head.append(f"bit_depth = {int(np.ceil(np.log2(white + 1)))}")
    else:
        why = f"bits of a count: of the camera's data sheet; the largest count found is {largest}"
        head.append(f"# bit_depth =    # missing: {why}")
        bits = max(12, int(np.ceil(np.log2(largest + 1))))
        missing.append(MissingKey("[camera]", f"bit_depth = {bits}", why, True))
    for key in ("model", "pixel_pitch_um", "gain_e_per_dn"):
        value = _common(frames, key)
        if value is not None:
            head.append(f"{key} = {_quoted(value) if isinstance(value, str) else f'{value:g}'}")
    pattern, focal = _common(frames, "pattern"), _common(frames, "focal_length_mm")
    if pattern is not None:
        head += ["", "[mosaic]", f"pattern = {_quoted(pattern)}"]
    head += ["", "[lens]"] + ([] if focal is None else [f"focal_length_mm = {focal:g}"])
    stated = {line.partition(" = ")[0] for line in head}
    missing += [
        MissingKey(where, example_of(table, key), table.model_fields[key].description or "", False)
        for where, table, keys in _USEFUL
        for key in keys
        if key not in stated
    ]
    return "\n".join(head) + "\n"
