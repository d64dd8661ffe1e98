"""Frames of a folder sorted into tables: kind, band, exposure and repeats."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError

from .folder_frames import FolderFrame, LeftOut, contradictions, natural_key, show_the_same
from .frame_names import (
    SCENE_WORDS,
    FrameName,
    common_words,
    doubtful_word,
    is_setting,
    kind_in_words,
    may_mean_dark,
    parse_name,
    undated,
)
from .manifest import channel_letters

__all__ = [
    "FrameGroup",
    "FrameRole",
    "by_channel",
    "common_values",
    "corrections",
    "group_frames",
    "group_notes",
    "require_roles",
]

#: Range of a picture's block means over that of a frame without light, at least: a hundredth of the light is light.
_LIT = 200.0

#: Kinds that the user may state of a frame; "none" leaves it out.
_KINDS = ("band", "dark", "flat", "reference", "target", "none")

#: Number at the end of a word by which a camera counts photographs, such as Image0001.
_COUNTER = re.compile(r"(?:^[a-z]*|(?<=[a-z]))\d{4,}$")

#: A filter that the user states, which becomes the name of a band.
_FILTER_NAME = re.compile(r"[A-Za-z0-9][\w.+-]{0,39}")


@dataclass(frozen=True)
class FrameRole:
    """Kind, filter and exposure of a frame by the user, before those of header and name."""

    #: Path of the file in the manifest.
    file: str
    #: "band", "dark", "flat", "reference", "target", or "none" for a frame that is not used.
    kind: str
    #: The filter; empty where header or name shall say it.
    filter: str = ""
    #: Exposure time, s; None where header or name shall say it.
    exposure_s: float | None = None


def require_roles(folder: Path, roles: Sequence[FrameRole], frames: Sequence[FolderFrame]) -> None:
    """Require that roles are of frames of the folder, of kinds that exist.

    Parameters
    ----------
    folder
        The folder, for messages.
    roles
        What the user says of frames.
    frames
        The frames of the folder.

    Raises
    ------
    InputError
        For another file, kind, exposure, or a filter that is no name.
    """
    files = {frame.listed for frame in frames}
    for role in roles:
        where = f"{folder}: {role.file[:80]}"
        if role.file not in files:
            raise InputError(where, "no frame of the folder", "one of its frames")
        if role.kind not in _KINDS:
            raise InputError(where, f"the kind {role.kind[:40]!r}", f"one of {', '.join(_KINDS)}")
        if role.filter and _FILTER_NAME.fullmatch(role.filter) is None:
            raise InputError(where, f"the filter {role.filter[:60]!r}", "a name without blanks, such as f550")
        if role.exposure_s is not None and not (math.isfinite(role.exposure_s) and role.exposure_s > 0):
            raise InputError(where, f"the exposure {role.exposure_s:g} s", "seconds above 0, such as 4.0")


@dataclass(frozen=True, eq=False)
class FrameGroup:
    """Frames of one table of the manifest: repeats of one exposure."""

    #: "band", "dark", "flat", "reference" or "target".
    kind: str
    #: Identifier of the band; None for darks and targets.
    band: str | None
    #: Exposure time, s; None if neither header nor name states it.
    exposure_s: float | None
    #: F-number by the header; None if not stated.
    f_number: float | None
    #: Whether a filter is stated, by the header or the name.
    has_filter: bool
    #: The frames, by time where the files state it, else by name.
    frames: tuple[FolderFrame, ...]

    @property
    def time(self) -> datetime | None:
        """Earliest moment of the frames; None unless all state it."""
        times = [frame.facts.time for frame in self.frames]
        return None if None in times else min(time for time in times if time is not None)


@dataclass(frozen=True, eq=False)
class _Classified:
    """A frame with what its header and its name say."""

    frame: FolderFrame
    name: FrameName
    #: Kind by the header, else by the name; "band" where neither names one.
    kind: str
    #: Filter by the header, else by the name.
    filter: str | None
    exposure_s: float | None
    f_number: float | None
    #: Whether the user states the kind.
    has_role: bool = False


def _classified(frame: FolderFrame, ignored: int, role: FrameRole | None) -> _Classified:
    facts, stem = frame.facts, frame.stem
    if facts.filter and stem.lower().endswith(facts.filter.lower()):  # MaxIm DL: box-001F450
        stem = stem[: -len(facts.filter)] or stem
    name = parse_name(stem, ignored, frame.folder)
    if role is not None:
        # words of the name say nothing more; frames of one filter or of one kind are repeats
        series = name.series if role.kind == "band" and not role.filter else ""
        name = replace(name, kind=role.kind, other_words=(), repeat=None, series=series)
        exposure = role.exposure_s or facts.exposure_s or name.exposure_s
        band = role.filter or ("-".join(facts.filter.split()) if facts.filter else name.filter)
        return _Classified(frame, name, role.kind, band, exposure, facts.f_number, has_role=True)
    kind = kind_in_words(facts.kind or "") or name.kind or "band"
    band = "-".join(facts.filter.split()) if facts.filter else name.filter
    exposure = facts.exposure_s if facts.exposure_s is not None else name.exposure_s
    return _Classified(frame, name, kind, band, exposure, facts.f_number)


def _doubt(item: _Classified, bands: Mapping[str, str]) -> str | None:
    """Reason why the kind of a frame by its name is not certain.

    None if it is certain, or if the header states it. ``bands`` has the bands by the words of their names: a flat may
    name its band.
    """
    if item.has_role or kind_in_words(item.frame.facts.kind or "") is not None:
        return None
    kind = item.name.kind
    other_words = "-".join(word for word in item.name.other_words if not is_setting(word))
    if kind is not None and other_words and other_words not in bands:
        return f"'{kind}' in its name may be a kind of frame or a word, since '{other_words}' stands next to it"
    other = [word for word in item.name.other_words if parse_name(word).kind is not None]
    if kind is None and len(other) > 1:
        return f"its name has both '{other[0]}' and '{other[1]}'"
    if kind is None and other:
        return f"'{other[0]}' in its name may be a kind of frame or a word, since it does not come first"
    return doubtful_word(item.name) if kind is None else None


def _shows_no_light(item: _Classified, items: Sequence[_Classified]) -> bool:
    """Whether a frame is even, and darker than all of a picture of the same settings.

    False where its kind or filter is stated. Cameras number pictures behind a covered lens as all others.
    """
    blocks, facts = item.frame.blocks, item.frame.facts
    is_stated = item.has_role or item.filter is not None or kind_in_words(facts.kind or "")
    if item.kind != "band" or is_stated or not blocks.size:
        return False
    alike = [
        other.frame.blocks
        for other in items
        if other.frame.blocks.size
        and (other.exposure_s, other.frame.facts.iso, other.kind) == (item.exposure_s, facts.iso, "band")
    ]
    return any(
        np.ptp(picture) > _LIT * max(float(np.ptp(blocks)), 1.0)
        and blocks.max() < picture.min() + np.ptp(picture) / _LIT
        for picture in alike
    )


def _band(item: _Classified, bands: Mapping[str, str]) -> str | None:
    """The band of a flat or reference: by its filter, by the words of its name, or the only one."""
    other_words = "-".join(item.name.other_words)
    if item.filter is not None:
        return item.filter if item.filter in bands.values() else None
    if other_words in bands:
        return bands[other_words]
    only = set(bands.values())
    return only.pop() if not other_words and len(only) == 1 else None


def _band_ids(scenes: Sequence[_Classified]) -> dict[int, str]:
    """Identifier of the band of each frame of a scene, by the frame's ``id``.

    The filter is the band, unless frames of one filter differ in words: then the words are part of it. Without a
    filter, the name is the band, without the number of the repeat where the numbers count repeats.
    """
    ids: dict[int, str] = {}
    repeats_of = _repeats(scenes)
    by_filter: dict[str, list[_Classified]] = defaultdict(list)
    series: dict[str, list[_Classified]] = defaultdict(list)
    for item in scenes:
        if item.filter is not None:
            by_filter[item.filter].append(item)
        else:
            series[item.name.series].append(item)
    for band, items in by_filter.items():
        texts = {id(item.frame): tuple(_COUNTER.sub("", word) for word in item.name.other_words) for item in items}
        differ = len(set(texts.values())) > 1
        for item in items:
            ids[id(item.frame)] = "-".join([*filter(None, texts[id(item.frame)]), band]) if differ else band
    for name, items in series.items():
        repeats = _count_repeats(items)
        for item in items:
            ids[id(item.frame)] = (name if repeats else item.name.stem) or item.name.stem
    for item in scenes:
        first = repeats_of[id(item.frame)]
        if item.filter is None and first is not item:
            ids[id(item.frame)] = ids[id(first.frame)]
    return ids


def _repeats(items: Sequence[_Classified]) -> dict[int, _Classified]:
    """First of the photographs of one picture with numbers that follow, by ``id`` of a frame."""
    first: dict[int, _Classified] = {}
    before: _Classified | None = None
    for item in sorted(items, key=lambda item: natural_key(undated(item.name.stem))):
        alike = (
            before is not None
            and (before.kind, before.filter) == (item.kind, item.filter)
            and _follows(undated(before.name.stem), undated(item.name.stem))
            and show_the_same(before.frame, item.frame)
        )
        first[id(item.frame)] = first[id(before.frame)] if before is not None and alike else item
        before = item
    return first


def _follows(before: str, after: str) -> bool:
    """Whether two names differ by a last number alone, which goes up by one."""
    first, second = (re.fullmatch(r"(.*?)(\d+)", stem) for stem in (before, after))
    return first is not None and second is not None and first[1] == second[1] and int(second[2]) - int(first[2]) == 1


def _count_repeats(items: Sequence[_Classified]) -> bool:
    """Whether the last numbers of names that agree otherwise count repeats of one exposure."""
    numbers = sorted(item.name.repeat for item in items if item.name.repeat is not None)
    if len(numbers) < len(items):
        return len(items) == 1
    first = numbers[0] if numbers else 0
    consecutive = first in (0, 1) and numbers == list(range(first, first + len(numbers)))
    return consecutive and len({(item.exposure_s, item.f_number, item.frame.facts.iso) for item in items}) == 1


def _numbered_alike(groups: Sequence[FrameGroup]) -> list[tuple[str, ...]]:
    """Bands whose names differ by a last number alone, which may count repeats or not."""
    series: dict[tuple[str, float | None], list[str]] = defaultdict(list)
    for group in groups:
        number = re.fullmatch(r"(.*?)\d+", group.band or "")
        if group.kind == "band" and number is not None and parse_name(str(group.band)).filter is None:
            series[number[1], group.exposure_s].append(str(group.band))
    return [tuple(dict.fromkeys(bands)) for bands in series.values() if len(set(bands)) > 1]


def by_channel(group: FrameGroup, pattern: str | None) -> list[tuple[FrameGroup, str | None]]:
    """The tables of a group with their channels.

    Frames without a filter in front of a mosaic are one table for each channel.

    Parameters
    ----------
    group
        A group of a folder.
    pattern
        Mosaic of the frames; None without one.

    Returns
    -------
    list
        Groups with the letter of a channel, or None.
    """
    if pattern is None or group.band is None or group.has_filter:
        return [(group, None)]
    return [(replace(group, band=f"{group.band}-{letter}"), letter) for letter in channel_letters(pattern)]


def corrections(groups: Sequence[FrameGroup]) -> str:
    """Corrections that all frames of the scene have by their files.

    Parameters
    ----------
    groups
        The groups of a folder.

    Returns
    -------
    str
        "D" for the dark level, "F" for flats, unless the folder has darks or flats.
    """
    kinds = {group.kind for group in groups}
    scenes = [frame for group in groups if group.kind == "band" for frame in group.frames]
    return "".join(
        letter
        for letter, kind in (("D", "dark"), ("F", "flat"))
        if kind not in kinds and all(letter in frame.facts.corrected for frame in scenes)
    )


def group_notes(groups: Sequence[FrameGroup]) -> list[tuple[str, str]]:
    """Notes on what files and folders say in two ways.

    Parameters
    ----------
    groups
        The groups of a folder.

    Returns
    -------
    list
        Table or file, and the note.
    """
    notes = []
    for group in groups:
        sessions = list(dict.fromkeys(frame.session for frame in group.frames))
        if len(sessions) > 1:
            why = (
                f"frames of {' and '.join(sessions[:4])} are repeats in it: where light, box or camera changed "
                "between them, start a capture in each folder"
            )
            notes.append((f"[[{group.kind}]] of {group.frames[0].listed}", why))
    frames = [frame for group in groups for frame in group.frames]
    doubts = {frame.listed: (*frame.facts.doubts, *contradictions(frame)) for frame in frames}
    for doubt in dict.fromkeys(doubt for of_file in doubts.values() for doubt in of_file):
        files = [file for file, of_file in doubts.items() if doubt in of_file]
        notes.append((files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} others", doubt))
    for alike in _numbered_alike(groups):
        why = (
            f"{alike[0]} to {alike[-1]} differ by a number alone: if they are repeats, list them in one table; if "
            "they show a printed board, name them 'board-...'"
        )
        notes.append(("[[band]]", why))
    return [*notes, *_clock_notes(groups), *_dark_notes(groups)]


def _clock_notes(groups: Sequence[FrameGroup]) -> list[tuple[str, str]]:
    """Frames that state an earlier time than one of a smaller number, where one counter runs."""
    scenes = [frame for group in groups if group.kind == "band" for frame in group.frames]
    numbers = [int(match[0]) if (match := re.search(r"\d+$", frame.stem)) else None for frame in scenes]
    if len(set(numbers)) < len(scenes) or None in numbers:
        return []
    notes = []
    ordered = sorted(zip(numbers, scenes, strict=True), key=lambda pair: pair[0] or 0)
    for (_, before), (_, after) in itertools.pairwise(ordered):
        times = before.facts.time, after.facts.time
        if times[0] is not None and times[1] is not None and times[1] < times[0]:
            why = (
                f"{after.listed} states an earlier time ({times[1]}) than {before.listed} ({times[0]}): if the clock "
                "was set back, state start_s in every [[band]]"
            )
            notes.append(("every [[band]]", why))
    return notes


def _dark_notes(groups: Sequence[FrameGroup]) -> list[tuple[str, str]]:
    """Exposures of bands that no dark has, where there are darks of other exposures."""
    darks = {group.exposure_s for group in groups if group.kind == "dark"} - {None}
    of_bands = {group.exposure_s for group in groups if group.kind == "band"} - {None} - darks
    if not darks or not of_bands:
        return []
    listing = ", ".join(f"{exposure:g} s" for exposure in sorted(e for e in of_bands if e is not None))
    why = f"no dark of {listing}, an exposure of the bands: take some, else their level is extrapolated in time"
    return [("[[dark]]", why)]


def common_values(groups: Sequence[FrameGroup]) -> dict[str, float]:
    """Exposure and f-number on which all tables agree, where there are several.

    Parameters
    ----------
    groups
        The groups of a folder.

    Returns
    -------
    dict
        By key of a table of frames, the value in s or the f-number.
    """
    of_keys = {
        "exposure_s": [group.exposure_s for group in groups if group.kind != "target"],
        "f_number": [group.f_number for group in groups if group.kind not in ("dark", "target")],
    }
    return {
        key: values[0]
        for key, values in of_keys.items()
        if len(values) > 1 and len(set(values)) == 1 and values[0] is not None
    }


def group_frames(
    frames: Sequence[FolderFrame], roles: Sequence[FrameRole] = ()
) -> tuple[list[FrameGroup], list[LeftOut]]:
    """Sort frames into tables.

    Frames are repeats if they agree in kind, band, exposure, f-number and ISO. Where the exposure is unknown, their
    names must agree, too, but for the number of the repeat.

    Parameters
    ----------
    frames
        The frames of a folder.
    roles
        What the user says of some of them.

    Returns
    -------
    tuple
        The groups: bands in the order of time where all files state it, else of their names; then darks, flats,
        references and targets. And the frames without a table, with the reason.
    """
    ignored = common_words([frame.stem for frame in frames])
    role_of = {role.file: role for role in roles}
    unused = [frame for frame in frames if frame.listed in role_of and role_of[frame.listed].kind == "none"]
    every = [_classified(frame, ignored, role_of.get(frame.listed)) for frame in frames if frame not in unused]
    unlit = [item for item in every if _shows_no_light(item, every)]
    items = [item for item in every if item not in unlit]
    covered = [item for item in unlit if may_mean_dark(item.name)]
    items += [replace(item, kind="dark", name=replace(item.name, kind="dark", other_words=())) for item in covered]
    unlit = [item for item in unlit if item not in covered]
    scenes = [item for item in items if item.kind == "band" and _doubt(item, {}) is None]
    ids = _band_ids(scenes)
    bands = {"-".join(item.name.other_words) or item.name.stem: ids[id(item.frame)] for item in scenes}
    bands |= {word.partition("-")[2]: band for word, band in bands.items() if word.partition("-")[0] in SCENE_WORDS}
    bands |= {band: band for band in ids.values()}
    why = "no light in it: name it 'dark-...' if the lens was covered, or name it in capture.toml"
    left_out = [LeftOut(item.frame.listed, why, is_frame=True) for item in unlit]
    left_out += [LeftOut(frame.listed, "not used, as you said", is_frame=True) for frame in unused]
    items, other_gain = _of_one_gain(items)
    left_out += other_gain
    repeats_of = _repeats(items)
    groups: dict[tuple[object, ...], list[_Classified]] = defaultdict(list)
    for item in items:
        if (doubt := _doubt(item, bands)) is not None:
            reason = f"{doubt}: rename it, or name it in capture.toml"
            left_out.append(LeftOut(item.frame.listed, reason, is_frame=True))
            continue
        has_lens = item.kind not in ("dark", "target")
        band = (ids[id(item.frame)] if item.kind == "band" else _band(item, bands)) if has_lens else None
        if has_lens and band is None:
            reason = f"a {item.kind} whose band has no frames of the scene"
            left_out.append(LeftOut(item.frame.listed, reason, is_frame=True))
            continue
        # Exposures that are not known may differ: then only the names say which frames are repeats.
        name = repeats_of[id(item.frame)].name.series if item.exposure_s is None and item.kind != "target" else ""
        f_number = item.f_number if has_lens else None
        groups[item.kind, band, item.exposure_s, f_number, item.frame.facts.iso, name].append(item)
    return _sorted([_group(band, members) for (_, band, *_), members in groups.items()]), left_out


def _of_one_gain(items: Sequence[_Classified]) -> tuple[list[_Classified], list[LeftOut]]:
    """The frames of the most common gain, and the others: a capture has one."""
    gains = Counter(item.frame.facts.gain_e_per_dn for item in items)
    del gains[None]
    if len(gains) < 2:
        return list(items), []
    common = gains.most_common(1)[0][0]
    others = [item for item in items if item.frame.facts.gain_e_per_dn not in (common, None)]
    why = f"e-/DN, and most frames {common:g}: a capture has one gain; put them into a folder for themselves"
    left_out = [
        LeftOut(item.frame.listed, f"its gain is {item.frame.facts.gain_e_per_dn:g} {why}", is_frame=True)
        for item in others
    ]
    return [item for item in items if item not in others], left_out


def _group(band: object, items: Sequence[_Classified]) -> FrameGroup:
    """One table, its frames by time where all of them state it, else by name."""
    frames = [item.frame for item in items]
    times = {id(frame): frame.facts.time or datetime.min for frame in frames}
    if None in [frame.facts.time for frame in frames]:
        times = dict.fromkeys(times, datetime.min)
    ordered = sorted(frames, key=lambda frame: (times[id(frame)], natural_key(frame.listed)))
    name = None if band is None else str(band)
    first = items[0]
    return FrameGroup(first.kind, name, first.exposure_s, first.f_number, first.filter is not None, tuple(ordered))


def _sorted(groups: Sequence[FrameGroup]) -> list[FrameGroup]:
    """Tables in the order of the manifest; bands by time where all of them state it."""
    by_time = all(group.time is not None for group in groups if group.kind == "band")

    def key(group: FrameGroup) -> tuple[object, ...]:
        moment = group.time if by_time and group.kind == "band" and group.time is not None else datetime.min
        exposure = float("inf") if group.exposure_s is None else group.exposure_s
        return group.kind, moment, natural_key(group.band or ""), exposure, natural_key(group.frames[0].listed)

    return sorted(groups, key=key)
