"""A first capture.toml from a folder of frames, and the list of what a person still has to add.

What a frame is comes from the file itself (exposure, f-number, filter, kind) and from its name: ``dark``,
``flat``, ``sphere`` or ``reference``, a filter such as ``f550`` or ``550nm``, an exposure such as ``4s`` or
``250ms``, and a last number that counts repeats.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing

from .foreign_frames import SUFFIXES, ForeignFrame, read_foreign

__all__ = ["FirstManifest", "write_first_manifest"]

_KINDS = {
    "dark": ("dark", "bias"),
    "flat": ("flat",),
    "reference": ("sphere", "reference", "integrating"),
    "target": ("target", "chessboard", "charuco", "checkerboard"),
}
_BAND = re.compile(r"(?:^|[^a-z0-9])(?:f|nm|band)?(\d{3,4})(?:nm)?(?=$|[^0-9a-z])")
_EXPOSURE = re.compile(r"(?:^|[^a-z0-9.])(\d+(?:[._]\d+)?)(ms|s|sec)(?=$|[^a-z])")


@dataclass(frozen=True)
class FirstManifest:
    """path : of the capture.toml written. tables : how many of each kind. missing : keys to add, and why."""

    path: Path
    tables: dict[str, int]
    missing: tuple[str, ...]


@dataclass(frozen=True)
class _Sorted:
    kind: str
    band: str | None
    exposure_s: float | None
    f_number: float | None
    frame: ForeignFrame


def _kind(frame: ForeignFrame) -> str:
    stated = f"{frame.said.get('kind', '')} {frame.name}".lower()
    return next((k for k, words in _KINDS.items() if any(word in stated for word in words)), "band")


def _band(frame: ForeignFrame) -> str | None:
    stated = str(frame.said.get("filter", "")).strip()
    if stated:
        return re.sub(r"\s+", "-", stated)
    found = _BAND.search(frame.name.lower())
    return f"f{found.group(1)}" if found else None


def _exposure(frame: ForeignFrame) -> float | None:
    if "exposure_s" in frame.said:
        return float(frame.said["exposure_s"])
    found = _EXPOSURE.search(frame.name.lower())
    if found is None:
        return None
    value = float(found.group(1).replace("_", "."))
    return value / 1000 if found.group(2) == "ms" else value


def _sorted(frame: ForeignFrame) -> _Sorted:
    kind = _kind(frame)
    band = None if kind in ("dark", "target") else _band(frame)
    if kind == "band" and band is None:
        # Without a filter the frame's own name, less the number of the repeat, tells scenes apart.
        band = re.sub(r"[-_ ]*\d+$", "", frame.name) or "all"
    f_number = None if kind in ("dark", "target") else frame.said.get("f_number")
    return _Sorted(kind, band, _exposure(frame), f_number, frame)


def _common(frames: Sequence[ForeignFrame], key: str) -> Any:
    values = Counter(f.said[key] for f in frames if key in f.said)
    return values.most_common(1)[0][0] if values else None


def _bit_depth(frames: Sequence[ForeignFrame]) -> int:
    stated = _common(frames, "white_level")
    largest = max(int(f.counts.max()) for f in frames)
    return int(np.clip(np.ceil(np.log2(max(stated or 0, largest) + 1)), 8, 16))


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _group(frames: Iterable[_Sorted]) -> dict[tuple[Any, ...], list[_Sorted]]:
    groups: dict[tuple[Any, ...], list[_Sorted]] = {}
    for one in frames:
        groups.setdefault((one.kind, one.band, one.exposure_s, one.f_number), []).append(one)
    return groups


def _table(
    header: str, lines: list[str], group: Sequence[_Sorted], paths: dict[int, str], missing: list[str]
) -> str:
    listed = ", ".join(_quoted(paths[id(one.frame)]) for one in group)
    text = "\n".join([f"[[{header}]]", *lines, f"frames = [{listed}]"])
    exposure, f_number = group[0].exposure_s, group[0].f_number
    where = f"{header} {group[0].band or ''} ({paths[id(group[0].frame)]})".replace("  ", " ")
    if exposure is not None:
        text += f"\nexposure_s = {exposure:g}"
    elif header != "target":
        # The file must load: an exposure of 1 s is a stand-in that is asked for by name.
        text += "\nexposure_s = 1.0  # not known: please correct"
        missing.append(f"{where}: exposure_s, which neither file nor name tells; 1.0 was written")
    if f_number is not None and header not in ("dark", "target"):
        text += f"\nf_number = {f_number:g}"
    return text + "\n"


def write_first_manifest(folder: Path) -> FirstManifest:
    """Sort the frames of a folder (and of its folder ``frames``) and write ``capture.toml``.

    Frames that are no TIFF are written once more as 16-bit TIFF in ``frames/``; TIFFs stay where they are.
    Raises InputError where a capture.toml exists, where there are no frames, or frames of several sizes, and
    for files that cannot be read.
    """
    folder = Path(folder)
    path = folder / "capture.toml"
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a folder of frames")
    if path.exists():
        raise InputError(path, "a file that exists already", "none", "Move it away to start again.")
    files = sorted(
        p for place in (folder, folder / "frames") if place.is_dir() for p in place.iterdir()
        if p.suffix.lower() in SUFFIXES
    )  # fmt: skip
    frames = [frame for file in files for frame in read_foreign(file)]
    if not frames:
        raise InputError(folder, "no frames", f"files ending in {', '.join(SUFFIXES)}")
    sizes = Counter(frame.counts.shape for frame in frames)
    if len(sizes) > 1:
        common = sizes.most_common(1)[0][0]
        odd = next(frame for frame in frames if frame.counts.shape != common)
        raise InputError(
            odd.path, f"{odd.counts.shape[1]} x {odd.counts.shape[0]} px",
            f"{common[1]} x {common[0]} as the other frames",
        )  # fmt: skip
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
) -> tuple[str, dict[str, int], list[str]]:
    height, width = frames[0].counts.shape
    missing: list[str] = []
    head = [
        'format = "capture/1"', f"name = {_quoted(folder.resolve().name)}", "", "[camera]",
        f"width_px = {width}", f"height_px = {height}", f"bit_depth = {_bit_depth(frames)}",
    ]  # fmt: skip
    for key, why in (
        ("model", ""), ("pixel_pitch_um", "for an absolute scale"),
        ("gain_e_per_dn", "unless flats and darks have repeats"),
    ):  # fmt: skip
        value = _common(frames, key)
        if value is not None:
            head.append(f"{key} = {_quoted(value) if isinstance(value, str) else f'{value:g}'}")
        elif why:
            missing.append(f"camera.{key}, {why}")
    missing.append("camera.bit_depth: check it; it was taken from the largest count")
    pattern, focal = _common(frames, "pattern"), _common(frames, "focal_length_mm")
    if pattern is not None:
        head += ["", "[mosaic]", f"pattern = {_quoted(pattern)}"]
    if focal is not None:
        head += ["", "[lens]", f"focal_length_mm = {focal:g}"]
    missing += ["camera.quantum_efficiency, lens.transmittance and band.transmittance (spectra), for XYZ"]
    if focal is None:
        missing.append("lens.focal_length_mm, for an absolute scale and to start the camera's fit")
    missing.append("band.image_distance_mm, for an absolute scale")
    blocks = ["\n".join(head) + "\n"]
    tables: Counter[str] = Counter()
    groups = _group(_sorted(frame) for frame in frames)
    scenes = {band for kind, band, *_ in groups if kind == "band"}
    seen: set[str] = set()
    for (kind, band, *_), group in sorted(groups.items(), key=lambda item: str(item[0])):
        header, lines = kind, [] if band is None else [f"band = {_quoted(band)}"]
        if kind == "band":
            # Of several exposures of a band the first is the band, the others are its brackets.
            header = "bracket" if band in seen else "band"
            lines = lines if header == "bracket" else [f"id = {_quoted(str(band))}"]
            seen.add(str(band))
        elif kind == "reference":
            missing.append(f"reference {band}: radiance of the source; the table was left out")
            continue
        elif kind == "target":
            missing.append(f"{paths[id(group[0].frame)]}: [[target]] with kind, rows, columns, pitch_mm")
            continue
        elif kind == "flat" and band not in scenes:
            missing.append(
                f"{paths[id(group[0].frame)]}: a band that has frames of the scene; it was left out"
            )
            continue
        tables[header] += 1
        blocks.append(_table(header, lines, group, paths, missing))
    if not tables["band"]:
        raise InputError(folder, "no frame of a scene", "at least one that is no dark, flat or reference")
    if not tables["dark"]:
        missing.append("[[dark]]: no frame is named dark; without them a dark level of 0 is assumed")
    if not tables["flat"]:
        missing.append("[[flat]]: no frame is named flat; without them vignetting stays in")
    missing += ["[geometry]: surveyed points, for the camera", "[lamp]: its radiance, for renders"]
    return "\n".join(blocks), dict(tables), missing
