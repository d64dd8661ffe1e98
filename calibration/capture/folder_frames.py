"""Frames of a folder: each photograph once, and every other file with a reason."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from unicodedata import normalize

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import other_format
from numpy.typing import NDArray

from ..frame_readers import FrameFacts, frame_header, read_pictures, reader_of, settings_of
from .frame_names import is_session, parse_name, states_frames

__all__ = [
    "FolderFrame",
    "LeftOut",
    "contradictions",
    "convert_bands",
    "frames_in",
    "mosaic_of",
    "natural_key",
    "require_one_size",
    "show_the_same",
]

#: The folder in which frames of a capture usually lie, and into which bands of one file are written.
FRAMES_FOLDER = "frames"
#: Blocks across a picture whose means are compared: fine enough for the walls of a box, coarse enough for no noise.
_BLOCKS = 8
#: Largest difference of two pictures' block means, of their range, up to which they show the same scene and light.
_SAME_PICTURE = 0.01
#: Largest logarithm of the ratio of exposures in a name and a header: names are rounded, 1/3 s to 0.3.
_SAME_EXPOSURE = 0.2
#: Folders of frames, for messages.
_WHERE_FRAMES_LIE = (
    f"frames lie in the folder, in {FRAMES_FOLDER}/, or in one named as its frames or by their date, such as darks/"
)
#: Number of files whose digests and block means are remembered: a kilobyte each.
_MAX_REMEMBERED = 4096

#: What file managers add to the name of a copy, in some languages.
_MANAGERS_COPY = re.compile(
    r"^(?:copy of|kopie von|copie de|copia de) |(?:\s*-)?\s+(?:copy|kopie|copie|copia)(?:\s*\(?\d+\)?)?$|\s*\(\d+\)$"
)


@dataclass(frozen=True)
class LeftOut:
    """A file of the folder that the manifest does not name."""

    #: Path relative to the folder, with forward slashes.
    file: str
    #: Why it is not named.
    why: str
    #: Whether it is a frame, which a `FrameRole` can put into a table.
    is_frame: bool = False


@dataclass(frozen=True, eq=False)
class FolderFrame:
    """A file of one exposure: one photograph, or as many repeats as it holds pictures."""

    #: Path of the file.
    path: Path
    #: Path in the manifest, relative to the folder.
    listed: str
    #: Name without folder and ending; with the name of the band where the file holds several.
    stem: str
    #: (height, width) of the pictures, px.
    shape: tuple[int, int]
    #: What the file says of camera and lens.
    facts: FrameFacts
    #: Number of the band's picture in a file of several bands; None for all others.
    band_number: int | None
    #: Largest count, DN.
    largest: int
    #: Zero bits at the end of all counts: 4 where each is a multiple of 16.
    zero_bits: int
    #: Digest of each picture's counts.
    digests: tuple[str, ...]
    #: (8, 8) means of blocks of the first picture, DN; empty for pictures of fewer pixels across.
    blocks: NDArray[np.float64]
    #: Words of the folders that state what their frames are, such as "darks-1s"; empty for others.
    folder: str
    #: Those digests without pictures of one count everywhere, which two photographs may share.
    varied_digests: frozenset[str]

    @property
    def session(self) -> str:
        """Folders that do not state what their frames are, such as "2026-11-02"; empty for none."""
        folders = self.listed.removeprefix(f"{FRAMES_FOLDER}/").split("/")[:-1]
        return "/".join(name for name in folders if not states_frames(name))


def natural_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """Key to sort names by their numbers: f550-2 before f550-10.

    Parameters
    ----------
    text
        The name.

    Returns
    -------
    tuple
        Numbers and words of the name in their order.
    """
    pieces = re.findall(r"\d+|\D+", text)
    return tuple((0, int(piece), piece) if piece.isdecimal() else (1, 0, piece) for piece in pieces)


def _stem(path: Path) -> str:
    """Name of a file, in composed letters, without the ending by which its reader is chosen."""
    name, reader = path.name, reader_of(path)
    endings = () if reader is None else reader.suffixes
    ending = max((e for e in endings if name.lower().endswith(e)), key=len, default=path.suffix)
    return normalize("NFC", name[: len(name) - len(ending)] or name)  # a Mac writes ü as u and two dots


def _frame(path: Path, listed: str, stem: str, facts: FrameFacts, number: int | None) -> FolderFrame:
    counts = read_pictures(path, None if number is None else range(number, number + 1))
    digests = tuple(_digest(picture) for picture in counts)
    varied = frozenset(d for d, picture in zip(digests, counts, strict=True) if np.any(picture != picture[0, 0]))
    shape = (counts.shape[1], counts.shape[2])
    blocks = _block_means(counts[0])
    folder = "-".join(name for name in listed.split("/")[:-1] if states_frames(name))
    bits = int(np.bitwise_or.reduce(counts, axis=None))
    zeros = (bits & -bits).bit_length() - 1 if bits and varied else 0  # one value shows no steps
    largest = int(counts.max())
    return FolderFrame(path, listed, stem, shape, facts, number, largest, zeros, digests, blocks, folder, varied)


def _block_means(counts: NDArray[np.uint16]) -> NDArray[np.float64]:
    if min(counts.shape) < _BLOCKS:
        return np.zeros((0, 0))
    rows, columns = (np.linspace(0, size, _BLOCKS + 1).astype(int) for size in counts.shape)
    sums = np.add.reduceat(np.add.reduceat(counts, rows[:-1], 0, dtype=np.float64), columns[:-1], 1)
    return sums / np.outer(np.diff(rows), np.diff(columns))


def show_the_same(first: FolderFrame, second: FolderFrame) -> bool:
    """Whether two frames show one picture in one exposure, but for noise.

    Parameters
    ----------
    first
        A frame.
    second
        Another frame.

    Returns
    -------
    bool
        True if the files state the same settings, and the means of 8 x 8 blocks agree to 1 % of their range.
    """
    if first.shape != second.shape or not first.blocks.size:
        return False
    if any(getattr(first.facts, key) != getattr(second.facts, key) for key in ("exposure_s", "f_number", "iso")):
        return False
    span = min(float(np.ptp(first.blocks)), float(np.ptp(second.blocks)))
    return bool(np.abs(first.blocks - second.blocks).max() < _SAME_PICTURE * span)


def contradictions(frame: FolderFrame) -> list[str]:
    """Filter and exposure that the name of a frame states otherwise than its header.

    Parameters
    ----------
    frame
        The frame.

    Returns
    -------
    list of str
        A sentence each; the header's value is used.
    """
    name, facts = parse_name(frame.stem, 0, frame.folder), frame.facts
    notes = []
    of_header = parse_name(facts.filter or "").filter
    if name.filter is not None and of_header is not None and name.filter != of_header:
        notes.append(
            f"its name says the filter {name.filter} and its header {facts.filter}, which is used: one is wrong"
        )
    seconds = name.exposure_s, facts.exposure_s
    if seconds[0] and seconds[1] and abs(math.log(seconds[0] / seconds[1])) > _SAME_EXPOSURE:
        notes.append(f"its name says {seconds[0]:g} s and its header {seconds[1]:g} s, which is used: one is wrong")
    return notes


def _digest(counts: NDArray[np.uint16]) -> str:
    return hashlib.sha256(repr(counts.shape).encode() + np.ascontiguousarray(counts).tobytes()).hexdigest()


def _frames_of_file(folder: Path, path: Path) -> Sequence[FolderFrame]:
    """Frames of a file, read once until it changes.

    A page that checks each entry asks for them again.
    """
    state = path.stat()
    return _read_frames(folder, path, state.st_mtime_ns, state.st_ctime_ns, state.st_size)


@lru_cache(_MAX_REMEMBERED)
def _read_frames(folder: Path, path: Path, _changed: int, _status: int, _size: int) -> tuple[FolderFrame, ...]:
    header, listed, stem = frame_header(path), path.relative_to(folder).as_posix(), _stem(path)
    if not header.bands:
        return (_frame(path, listed, stem, header.facts, None),)
    names = [stem + "-" + re.sub(r"[^\w.]+", "-", band) for band in header.bands]
    return tuple(
        _frame(path, f"{FRAMES_FOLDER}/{name}.tif", name, replace(header.facts, filter=band), number)
        for number, (name, band) in enumerate(zip(names, header.bands, strict=True))
    )


def _refusal(folder: Path, path: Path) -> str | None:
    """Reason why a file cannot be listed as a frame; None if it can."""
    if reader_of(path) is None:
        kind = other_format(path)
        return f"no frame: {kind or f'no reader takes {path.suffix or path.name!r}'}"
    if path.suffix.lower() == ".png":  # plots, labels and previews lie next to frames, too
        if "label" in path.stem.lower():
            return "no frame: an image of labels"
        try:
            frame_header(path)
        except InputError as error:
            return f"no frame: {error.found}"
    try:
        target = path.resolve(strict=True)
    except (OSError, RuntimeError):  # RuntimeError: a loop of links
        return "a link that leads to no file"
    if not target.is_relative_to(folder.resolve()):
        return "a link that leaves the folder: copy the file into it"
    if "\\" in path.name or not path.name.isprintable():
        return "a name with characters that a capture cannot list: rename it"
    return None


def frames_in(folder: Path) -> tuple[list[FolderFrame], list[LeftOut]]:
    """All frames of a folder and of its subfolders of frames, each photograph once.

    These are ``frames`` and those whose names say what they hold, such as ``darks``. Others are read where their names
    distinguish no frames, such as dates.

    A TIFF that holds the same counts as a file of another format was written from it, and is left out. So is one of
    two files that hold the same counts and have one name, or the name of a file manager's copy.

    Parameters
    ----------
    folder
        The folder.

    Returns
    -------
    tuple
        The frames, and all other files with the reason; tables (``.csv``) and hidden files are in neither.

    Raises
    ------
    InputError
        For a damaged frame, and for two files of one name with different counts.
    """
    frames: list[FolderFrame] = []
    others: list[LeftOut] = []
    parents = [folder, folder / FRAMES_FOLDER]
    for parent in parents:
        for path in sorted(parent.iterdir(), key=lambda p: natural_key(p.name)) if parent.is_dir() else ():
            listed = path.relative_to(folder).as_posix().encode("utf-8", "backslashreplace").decode()
            if path.name.startswith(".") or path.suffix.lower() == ".csv" or path == folder / FRAMES_FOLDER:
                continue
            if path.is_dir():
                if not _holds_frames(path):
                    continue
                if not path.is_symlink() and (states_frames(path.name) or _is_wrapper(path)):
                    parents.append(path)
                else:
                    others.append(LeftOut(f"{listed}/", f"a subfolder: {_WHERE_FRAMES_LIE}"))
            elif (why := _refusal(folder, path)) is not None:
                others.append(LeftOut(listed, why))
            else:
                frames += _frames_of_file(folder, path)
    settings = {file.relative_to(folder).as_posix() for f in frames if (file := settings_of(f.path)) is not None}
    return _without_copies(frames, [item for item in others if item.file not in settings])


def _holds_frames(path: Path) -> bool:
    """Whether a path is a frame, or a folder with frames at any depth."""
    if path.is_dir():
        return any(reader_of(p) is not None and p.is_file() for p in path.rglob("*"))
    return reader_of(path) is not None


def _is_wrapper(path: Path) -> bool:
    """Whether a folder's name distinguishes no frames.

    No frame lies next to it. It is alone, says when, or it holds kinds and no folder next to it states one.
    """
    siblings = [other for other in path.parent.iterdir() if other != path and _holds_frames(other)]
    if not all(other.is_dir() for other in siblings):
        return False
    return not siblings or is_session(path.name) or (_has_kinds(path) and not _has_kinds(path.parent))


def _has_kinds(path: Path) -> bool:
    return any(states_frames(other.name) and other.is_dir() for other in path.iterdir())


def _is_tiff(frame: FolderFrame) -> bool:
    reader = reader_of(frame.path)
    return reader is not None and reader.id == "tiff"


def _without_copies(frames: list[FolderFrame], others: list[LeftOut]) -> tuple[list[FolderFrame], list[LeftOut]]:
    """Each photograph once: files that hold the counts of another one move to ``others``."""
    originals = [frame for frame in frames if not _is_tiff(frame)]
    by_name: dict[str, FolderFrame] = {}
    photographs: list[FolderFrame] = []
    for frame in sorted(frames, key=lambda frame: (_is_tiff(frame), len(frame.stem))):
        key = f"{frame.session}/{frame.folder}/{frame.stem}".casefold()
        twin = by_name.get(key)
        if len(frame.varied_digests) == len(frame.digests):
            sources = [f for f in (originals if _is_tiff(frame) else []) if frame.varied_digests <= f.varied_digests]
            sources += [other for other in photographs if _is_managers_copy(frame, other)]
            twin = next(iter(sources), twin)
        if twin is None:
            by_name[key] = frame
            photographs.append(frame)
        elif not set(frame.digests) <= set(twin.digests):
            hint = "Rename one if they are two photographs; move one away if it was made from the other."
            description = f"the name of {twin.path.name} with other counts"
            raise InputError(frame.path, description, "a different name for each photograph", hint)
        elif twin.band_number is not None and frame.path == _target(twin, frame):
            # the band was written into this file before
            photographs[photographs.index(twin)] = replace(frame, facts=twin.facts)
        else:
            others.append(LeftOut(frame.listed, f"the same counts as {twin.listed}"))
    return sorted(photographs, key=lambda frame: natural_key(frame.listed)), others


def _is_managers_copy(frame: FolderFrame, other: FolderFrame) -> bool:
    """Whether a frame has another one's pictures, and the name of a file manager's copy."""
    names = [_MANAGERS_COPY.sub("", f.stem.casefold()) for f in (frame, other)]
    return frame.path != other.path and names[0] == names[1] and frame.digests == other.digests


def _target(band: FolderFrame, frame: FolderFrame) -> Path:
    """Path of the TIFF of a band in the folder of ``frame``."""
    return frame.path.with_name(Path(band.listed).name)


def convert_bands(folder: Path, frames: list[FolderFrame]) -> None:
    """Write each band of files with several bands into a TIFF, over no other file.

    Parameters
    ----------
    folder
        The folder.
    frames
        Its frames; those of files with one band stay as they are.

    Raises
    ------
    InputError
        If one of the files exists; then none is written.
    """
    bands = [frame for frame in frames if frame.band_number is not None]
    for frame in bands:
        if (folder / frame.listed).exists():
            raise InputError(folder / frame.listed, "a file that exists already", "no such file", "Move it away.")
    for frame in bands:
        number = frame.band_number or 0
        with replacing(folder / frame.listed) as temporary:
            counts = read_pictures(frame.path, range(number, number + 1))[0]
            tifffile.imwrite(temporary, counts, photometric="minisblack", metadata=None)


def require_one_size(frames: Sequence[FolderFrame]) -> None:
    """Require that all frames have one size.

    Parameters
    ----------
    frames
        The frames, at least one.

    Raises
    ------
    InputError
        For a frame of another size than most.
    """
    sizes = Counter(frame.shape for frame in frames)
    if len(sizes) > 1:
        common = sizes.most_common(1)[0][0]
        odd = next(frame for frame in frames if frame.shape != common)
        raise InputError(
            odd.path,
            f"{odd.shape[1]} x {odd.shape[0]} px",
            f"{common[1]} x {common[0]} px like the other frames",
        )


def mosaic_of(frames: Sequence[FolderFrame]) -> str | None:
    """Mosaic that the files state.

    Parameters
    ----------
    frames
        The frames.

    Returns
    -------
    str | None
        None where no file states one.

    Raises
    ------
    InputError
        If they state different ones.
    """
    frames_with_mosaic = [frame for frame in frames if frame.facts.pattern is not None]
    for frame in frames_with_mosaic:
        if frame.facts.pattern != frames_with_mosaic[0].facts.pattern:
            expected = f"'{frames_with_mosaic[0].facts.pattern}' as in {frames_with_mosaic[0].path.name}"
            raise InputError(frame.path, f"the mosaic '{frame.facts.pattern}'", expected)
    return frames_with_mosaic[0].facts.pattern if frames_with_mosaic else None
