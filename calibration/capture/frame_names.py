"""Names of frame files: kind, filter, exposure and repeat, where a name is certain.

A name is cut at ``-``, ``_``, blanks, brackets and semicolons, and at commas and points that are not between digits.
Each part is a kind of frame, a filter, an exposure, a date, a number or a word. What could be read in two ways is not
read at all: ``1-30s`` may be 1/30 s or the first frame of 30 s.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "KIND_WORDS",
    "SCENE_WORDS",
    "FrameName",
    "common_words",
    "doubtful_word",
    "is_session",
    "is_setting",
    "kind_in_words",
    "may_mean_dark",
    "parse_name",
    "states_frames",
    "undated",
    "unread_exposure",
]

#: By kind of table, the words for it in names. A word stands for itself: "darkroom" is none of them.
KIND_WORDS = {
    "dark": (
        *("dark", "darks", "bias", "darkframe", "darkflat", "flatdark"),
        *("masterdark", "masterbias", "superdark", "superbias", "biases", "darkflats", "flatdarks"),
        *("dunkelbild", "dunkelbilder", "dunkelstrom"),
    ),
    "flat": (
        *("flat", "flats", "flatfield", "flatfields", "flatframe", "masterflat", "superflat", "skyflat", "domeflat"),
        *("flatpanel", "weissbild", "weissbilder", "weißbild", "weißbilder", "plu"),
    ),
    "reference": ("sphere", "reference", "integrating"),
    "target": ("target", "board", "boards", "chessboard", "charuco", "checkerboard"),
}
#: Words for frames of the scene, which add nothing to a name.
SCENE_WORDS = frozenset({"light", "lights"})
#: Words for dark frames, and for dark things: the picture decides.
_DARK_WORDS = frozenset(
    {"background", "black", "capped", "covered", "dunkel", "noir", "noirs", "schwarz", "schwarzbild", "oscuro"}
    | {"oscuros", "oscura", "buio", "scuro", "escuro", "donker", "mörk", "mork", "ciemna", "ciemne"}
)
#: Words for flats, and for other pictures.
_FLAT_WORDS = frozenset({"hellbild", "hellbilder", "plano", "planos"})
#: By kind of table, the words for it in headers (IMAGETYP of FITS).
_HEADER_WORDS = {
    "band": ("light", "object", "science"),
    "dark": ("dark", "bias", "zero", "darkflat", "flatdark"),
    "flat": ("flat", "flatfield", "skyflat", "domeflat"),
    "reference": ("sphere", "reference", "integrating"),
}
#: Words next to a kind that add nothing to it.
_FILLERS = frozenset({"frame", "frames", "field", "sphere"})
#: A date, with or without the time of day, which cameras and programs put before or after a name. The time may have
#: thousandths of a second, or tenths of a minute (2210_3).
_DATE = re.compile(
    r"(?<![0-9a-z])(?:19|20)\d\d(?:-[01]\d-[0-3]\d|_[01]\d_[0-3]\d|[01]\d[0-3]\d)"
    r"(?P<time>[-_t ]+[0-2]\d[-_:]?[0-5]\d(?:[-_:]?[0-5]\d(?:[-_.]?\d{3})?|[_.]\d))?(?![0-9a-z])"
)
_SEPARATORS = re.compile(r"(?:[-_\s()\[\];+]|(?<!\d)[.,]|[.,](?!\d))+")
#: A filter by its wavelength: f550, 550nm, f550nm, band550, filter550, WL550. Camera numbers begin with 0 where they
#: have four digits.
_FILTER = re.compile(r"(?:f|band|filter|wl|wavelength|lambda)([1-9]\d{2,3})(?:nm)?|0*([1-9]\d{2,3})(?:\.0+)?nm")
#: A number that is a filter if nothing else in the name has letters.
_BARE_FILTER = re.compile(r"[1-9]\d\d")
#: Filters as makers name them, before the number of their bandwidth: FB550-10, BP550-40, ET550-20.
_MAKERS_FILTER = re.compile(r"(?:fb|fbh|fl|flh|bp|nb|bn|nf|lp|sp|et|hq|xbpa)\d{3,4}")
#: A number before a unit; with zeros in front it counts frames.
_AMOUNT = r"(?:0|[1-9]\d*)(?:[.,]\d+)?"
_UNIT = "us|µs|ms|s|secs?|mins?"
_EXPOSURE = re.compile(rf"(?:exp|exposure)?({_AMOUNT})({_UNIT})")
#: Units that programs write behind a separator: 300_secs, 550 nm.
_UNIT_PARTS = frozenset({"us", "µs", "ms", "sec", "secs", "nm"})
#: A number and a unit behind one blank: 2 min, 0.5 s. Behind another separator, these may be words.
_BLANK_BEFORE_UNIT = re.compile(rf"(?<![0-9a-z.,])({_AMOUNT}) ({_UNIT})(?![0-9a-z])")
#: Seconds in the units of exposures.
_UNIT_S = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "secs": 1.0, "min": 60.0, "mins": 60.0}
#: Words before or behind a time that is no exposure: a wait, or the model of a telephone.
_NOT_EXPOSED = frozenset(
    {"after", "at", "delay", "every", "interval", "iphone", "later", "on", "t", "timer", "up", "wait", "waited", "warm"}
    | {"warmed", "warmup"}
)
#: Words of pictures that add up several exposures, whose seconds are those of all together.
_SUMMED = re.compile(r"(?:live)?stack(?:ed)?|integrated|sum(?:med)?|total|\d+(?:frames|subs)")
#: A number before an exposure by which it is a fraction or a decimal: 1-30s, 1_4s, 1e-3s.
_PART_OF_NUMBER = re.compile(r"\d{1,2}|\d+(?:[.,]\d+)?e")
#: Two exposures as a range: 0.5-4s.
_RANGE = re.compile(r"\d[.,]\d+-\d+(?:[.,]\d+)?(?:us|µs|ms|s|secs?|mins?)(?![a-z])")
#: What may be an exposure, whatever it is read as: t100ms, 1-30s, 4_s, 2min, 1h.
_LIKE_EXPOSURE = re.compile(
    r"(?<![0-9a-z])t?\d+(?:(?:[-_.,]|e-?)\d+)*[-_\s]?(?:us|µs|ms|secs?|s|mins?|m|hrs?|h)(?![a-z0-9])"
)
#: A comma before three digits, which may separate thousands: 1,000s.
_THOUSANDS = re.compile(r"[1-9]\d*,\d{3}")
_NUMBERED_KIND = re.compile(r"([a-z]+?)(\d+(?:[.,]\d+)?(?:us|µs|ms|s|secs?|mins?)?)")
#: Things that differ by the number behind them, or are set to it: filter_2 is no repeat of filter_1.
_COUNTED = frozenset(
    {"band", "ch", "channel", "exp", "exposure", "filter", "fw", "lamp", "led", "pos", "position", "slot", "wheel"}
    | {"ev", "ga", "gain", "iso", "of"}
)
#: A name of a camera with its number, behind which a further number counts copies: DSC00550-2.
_PHOTOGRAPH = re.compile(r"[a-z0-9]*\d{4}")
#: A word that counts repeats, with its number.
_NUMBERED_REPEAT = re.compile(r"(?:rep|repeat|frame|shot)(\d{1,2})")
#: Temperature and binning of the sensor, which add nothing: -10.0C, -10.00, bin1, 1x1.
_STATE = re.compile(r"\d+(?:\.\d+)?c|\d+\.\d+|(?:bin)?\dx\d|bin\d")
#: A setting of the camera, which no frame is named after: gain100, ISO800.
_SETTING = re.compile(r"(?:gain|iso|offset)\d+")
#: Parts of the names of folders that say when: dates, times of day, sessions. And the folders of cameras.
_SESSION_PARTS = re.compile(
    r"(?<![0-9a-z])(?:(?:19|20)\d\d[-_. ]?[01]\d[-_. ]?[0-3]\d|[0-3]?\d[-_. ][01]?\d[-_. ](?:19|20)\d\d"
    r"|[0-2]\d[-_:.h ]?[0-5]\d[-_:.m ]?[0-5]\d(?:s|[-_.]\d+z?)?|[0-2]?\d[h:][0-5]\d"
    r"|(?:session|night|evening|day|run|sitzung|séance|seance|nuit|nacht|sesión|sesion)[-_ ]?\d{0,3}"
    r"|dcim|\d{3}(?:canon|eos\w\w|msdcf|olymp|_fuji|_pana|apple|nikon|nc[dz]\w\w|d\d{4}|ricoh|pentx|leica))"
    r"(?![0-9a-z])"
)
#: Wavelengths of filters that silicon sees, nm.
_FILTER_RANGE_NM = (250, 1200)
#: Digits of a number that counts repeats, at most: longer ones count a camera's photographs.
_MAX_REPEAT_DIGITS = 2


@dataclass(frozen=True)
class FrameName:
    """The parts of a frame's name; None where the name does not say them with certainty."""

    #: Name of the file without its ending.
    stem: str
    #: Kind of table that the first word names; None for another or no word of KIND_WORDS.
    kind: str | None
    #: Filter, such as "f550".
    filter: str | None
    #: Exposure time, s.
    exposure_s: float | None
    #: Last number of one or two digits, which counts repeats.
    repeat: int | None
    #: Words that are none of these, in small letters; a kind of frame is one where it does not come first.
    other_words: tuple[str, ...]
    #: The name without the number of the repeat, as written.
    series: str


def kind_in_words(text: str) -> str | None:
    """Kind of frame that a header states.

    Parameters
    ----------
    text
        Value of the header, such as "Light Frame".

    Returns
    -------
    str | None
        "band", "dark", "flat" or "reference"; None if its words name no kind, or several.
    """
    header_words = set(re.findall(r"[a-z]+", text.lower()))
    kinds = [kind for kind, names in _HEADER_WORDS.items() if header_words.intersection(names)]
    return kinds[0] if len(kinds) == 1 else None


def _kind_of_word(word: str) -> str | None:
    return next((kind for kind, names in KIND_WORDS.items() if word in names), None)


def _exposure(parts: list[str]) -> tuple[float | None, list[int]]:
    """The exposure, and the positions of parts that look like one.

    The exposure is None if several differ, if one is ambiguous, or if it is that of a sum of pictures.
    """
    values, positions = set(), []
    for index, part in enumerate(parts):
        match = _EXPOSURE.fullmatch(part)
        if match is None:
            continue
        positions.append(index)
        before, behind = parts[index - 1] if index else "", parts[index + 1] if index + 1 < len(parts) else ""
        # '1-30s' and '1_4s': a fraction, a decimal, or a repeat and whole seconds
        part_of_number = _PART_OF_NUMBER.fullmatch(before) or _THOUSANDS.fullmatch(match[1])
        ambiguous = part_of_number or not _NOT_EXPOSED.isdisjoint((before, behind))
        values.add(None if ambiguous else float(match[1].replace(",", ".")) * _UNIT_S[match[2]])
    summed = any(_SUMMED.fullmatch(part) for part in parts)
    value = values.pop() if len(values) == 1 and not summed else None
    return (value if value is not None and value > 0 else None), positions


def _filter(parts: list[str], bare: bool) -> tuple[str | None, list[int]]:
    """The filter, and the positions of parts that look like one; None if several differ.

    ``bare`` allows a number alone, unless it follows another one: ``1-500`` is an exposure of 1/500 s.
    """
    matches = {k: m[1] or m[2] for k, part in enumerate(parts) if (m := _FILTER.fullmatch(part))}
    if not matches and bare:
        matches = {
            k: part
            for k, part in enumerate(parts)
            if _BARE_FILTER.fullmatch(part) and not (k and parts[k - 1].isdigit() and len(parts[k - 1]) < len(part))
        }
    low, high = _FILTER_RANGE_NM
    matches = {k: text for k, text in matches.items() if low <= int(text) <= high}
    names = {f"f{text}" for text in matches.values()}
    return (names.pop() if len(names) == 1 else None), list(matches)


def common_words(stems: Sequence[str]) -> int:
    """Number of first words that all names share, such as the name of a project.

    Parameters
    ----------
    stems
        Names of all frames without their endings.

    Returns
    -------
    int
        0 for a single name. Kinds, filters, exposures and numbers are no such words.
    """
    names = [[part for part in _SEPARATORS.split(stem.lower()) if part] for stem in stems]
    if len(set(stems)) < 2:
        return 0
    count = 0
    for parts in zip(*names, strict=False):
        if len(set(parts)) > 1 or not _is_word(parts[0]):
            break
        count += 1
    return count


def _is_word(part: str) -> bool:
    """Whether a part of a name is none of kind, filter, exposure and number."""
    kind = any(_kind_of_word(piece) for piece in _without_number(part))
    return not (kind or _FILTER.fullmatch(part) or _EXPOSURE.fullmatch(part) or any(c.isdigit() for c in part))


def doubtful_word(name: FrameName) -> str | None:
    """Word of a name that may be a kind of frame, as "noir" and "plano" are.

    Parameters
    ----------
    name
        The name.

    Returns
    -------
    str | None
        The word with what it may mean; None for a name without such a word.
    """
    if may_mean_dark(name):
        return f"'{name.other_words[0]}' in its name may mean a dark frame or a dark thing"
    if name.other_words and name.other_words[0] in _FLAT_WORDS:
        return f"'{name.other_words[0]}' in its name may mean a flat field"
    return None


def may_mean_dark(name: FrameName) -> bool:
    """Whether a name without a filter says that the picture is dark, or of something dark.

    Parameters
    ----------
    name
        The name.

    Returns
    -------
    bool
        True for "noir_4s" and "background-1".
    """
    return name.filter is None and bool(name.other_words) and set(name.other_words) <= _DARK_WORDS


def states_frames(folder: str) -> bool:
    """Whether the name of a folder says what frames in it are, and nothing else.

    Parameters
    ----------
    folder
        Name of the folder.

    Returns
    -------
    bool
        True for "darks", "550nm", "flats 1s" and "lights"; False for "session2" and for dates.
    """
    parts = _with_units([part for part in _SEPARATORS.split(_without_blank(folder.lower())) if part])
    return bool(parts) and all(
        _kind_of_word(part) or part in SCENE_WORDS or _FILTER.fullmatch(part) or _EXPOSURE.fullmatch(part)
        for part in parts
    )


def is_session(folder: str) -> bool:
    """Whether the name of a folder says when its frames were taken, or a camera wrote it.

    Parameters
    ----------
    folder
        Name of the folder.

    Returns
    -------
    bool
        True for "2026-11-02", "02.11.2026 22h10", "session2", "night 1" and "100CANON".
    """
    text = _SESSION_PARTS.sub(" ", folder.lower())
    return not re.search(r"\w", text)


def parse_name(stem: str, ignored: int = 0, folder: str = "") -> FrameName:
    """Read the name of a frame.

    Parameters
    ----------
    stem
        Name of the file without its ending.
    ignored
        Number of first words that all names share, see ``common_words``.
    folder
        Words of the folders that state what their frames are, see ``states_frames``.

    Returns
    -------
    FrameName
        The properties that the name states with certainty.
    """
    lowered = _without_blank(stem.lower())
    dates = list(_DATE.finditer(lowered))
    # digits behind a time of day may be thousandths of a second
    timed = any(date["time"] for date in dates)
    parts = [part for part in _SEPARATORS.split(_DATE.sub(" ", lowered)) if part.strip(".,")]
    parts = [*_folder_parts(folder), *parts[ignored:]]
    parts = _with_units([piece for part in parts for piece in _without_number(part)])
    kinds = [_kind_of_word(part) for part in parts]
    # a kind after the first part is a word: 'box-flat' may be a flat of the box or a box that is flat
    certain = bool(kinds) and kinds[0] is not None and all(other in (None, kinds[0]) for other in kinds)
    exposure, exposure_parts = _exposure(parts)
    exposure = None if _RANGE.search(lowered) else exposure
    other_words = tuple(
        part
        for index, part in enumerate(parts)
        if not (part.isdigit() or index in exposure_parts or _FILTER.fullmatch(part) or _STATE.fullmatch(part))
        and not (certain and (kinds[index] is not None or part in _FILLERS))
    )
    # a number alone may count photographs: it is a filter only next to an exposure, a kind or a date
    numbered = bool(exposure_parts) or bool(dates) or (certain and kinds[0] != "dark")
    bare = numbered and not (other_words or ignored or timed or (certain and kinds[0] == "dark"))
    band, filter_parts = _filter(parts, bare)
    repeat = _repeat(parts, filter_parts, ignored)
    series = (
        re.sub(r"[-_\s(\[]*(?:rep|repeat|frame|shot)?\d+[)\]]?$", "", stem, flags=re.IGNORECASE)
        if repeat is not None
        else stem
    )
    if folder:
        stem, series = f"{folder}-{stem}", f"{folder}-{series}"
    return FrameName(stem, kinds[0] if certain else None, band, exposure, repeat, other_words, series)


def _folder_parts(folder: str) -> list[str]:
    """Parts of the names of folders, kinds of frames first."""
    parts = [part for part in _SEPARATORS.split(_without_blank(folder.lower())) if part and part not in SCENE_WORDS]
    return sorted(parts, key=lambda part: _kind_of_word(part) is None)


def _repeat(parts: list[str], filter_parts: list[int], ignored: int) -> int | None:
    """The last number, where it counts repeats.

    Behind a number that is no filter, a maker's filter or a thing that is counted, it may be anything.
    """
    last = len(parts) - 1
    if last < 0 or last + ignored == 0 or last in filter_parts:
        return None
    if not parts[last].isdigit() or len(parts[last]) > _MAX_REPEAT_DIGITS:
        return None
    before = parts[last - 1] if last else ""
    unread = before.isdigit() and last - 1 not in filter_parts
    photograph = last - 1 not in filter_parts and _PHOTOGRAPH.fullmatch(before)
    other = unread or photograph or before in _COUNTED or _MAKERS_FILTER.fullmatch(before)
    return None if other else int(parts[last])


def _without_blank(text: str) -> str:
    """A name with units behind their numbers: '2 min' as '2min'."""
    return _BLANK_BEFORE_UNIT.sub(r"\1\2", text)


def _with_units(parts: list[str]) -> list[str]:
    """The parts, with each number and the unit behind it as one: '300' and 'secs'."""
    joined: list[str] = []
    for part in parts:
        if joined and part in _UNIT_PARTS and re.fullmatch(_AMOUNT, joined[-1]):
            joined[-1] += part
        else:
            joined.append(part)
    return joined


def undated(stem: str) -> str:
    """A name without dates and times of day.

    Parameters
    ----------
    stem
        Name of the file without its ending.

    Returns
    -------
    str
        In small letters: "basler__0001" of "Basler_20261103_104510345_0001".
    """
    return _DATE.sub("", stem.lower())


def unread_exposure(stem: str) -> str | None:
    """Part of a name that may be an exposure, for a question where the exposure is not certain.

    Parameters
    ----------
    stem
        Name of the file without its ending.

    Returns
    -------
    str | None
        As written: "1-30s", "t100ms", "2min"; None for a name without such a part.
    """
    match = _LIKE_EXPOSURE.search(stem.lower())
    return None if match is None else stem[match.start() : match.end()]


def is_setting(word: str) -> bool:
    """Whether a word of a name is a setting of the camera.

    Parameters
    ----------
    word
        The word, in small letters.

    Returns
    -------
    bool
        True for "gain100" and "iso800".
    """
    return _SETTING.fullmatch(word) is not None


def _without_number(part: str) -> tuple[str, ...]:
    """The parts of 'dark01' and the number of 'rep3'.

    Another part stays as it is.
    """
    if (counted := _NUMBERED_REPEAT.fullmatch(part)) is not None:
        return (counted[1],)
    match = _NUMBERED_KIND.fullmatch(part)
    return (match[1], match[2]) if match is not None and _kind_of_word(match[1]) is not None else (part,)
