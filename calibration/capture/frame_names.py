"""Names of frame files: kind, filter, exposure and repeat, where a name is certain.

A name is cut at ``-``, ``_``, blanks and brackets. Each part is a kind of frame, a filter, an exposure, a date, a
number or a word. What could be read in two ways is not read at all: ``1-30s`` may be 1/30 s or the first frame of 30 s.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["KIND_WORDS", "FrameName", "common_words", "kind_in_words", "parse_name"]

#: By kind of table, the words for it in names. A word stands for itself: "darkroom" is none of them.
KIND_WORDS = {
    "dark": ("dark", "darks", "bias", "darkframe"),
    "flat": ("flat", "flats", "flatfield", "flatframe"),
    "reference": ("sphere", "reference", "integrating"),
    "target": ("target", "chessboard", "charuco", "checkerboard"),
}
#: By kind of table, the words for it in headers (IMAGETYP of FITS).
_HEADER_WORDS = {
    "band": ("light", "object", "science"),
    "dark": ("dark", "bias", "zero"),
    "flat": ("flat", "flatfield", "skyflat", "domeflat"),
    "reference": ("sphere", "reference", "integrating"),
}
#: Words next to a kind that add nothing to it.
_FILLERS = frozenset({"frame", "frames", "field", "sphere"})
#: A date, with or without the time of day, which cameras and programs put before or after a name.
_DATE = re.compile(
    r"(?<![0-9a-z])(?:19|20)\d\d(?:-[01]\d-[0-3]\d|_[01]\d_[0-3]\d|[01]\d[0-3]\d)"
    r"(?:[-_t ][0-2]\d[-_:]?[0-5]\d[-_:]?[0-5]\d)?(?![0-9a-z])"
)
_SEPARATORS = re.compile(r"[-_\s()\[\]+]+")
#: A filter by its wavelength: f550, 550nm, f550nm, band550. Camera numbers begin with 0 where they have four digits.
_FILTER = re.compile(r"(?:f|band)([1-9]\d{2,3})(?:nm)?|([1-9]\d{2,3})nm")
#: A number that is a filter if nothing else in the name has letters.
_BARE_FILTER = re.compile(r"[1-9]\d\d")
_EXPOSURE = re.compile(r"(\d+(?:[.,]\d+)?)(us|µs|ms|s|sec)")
#: Seconds in the units of exposures.
_UNIT_S = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
_NUMBERED_KIND = re.compile(r"([a-z]+?)(\d+)")
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

    The exposure is None if several differ or one is ambiguous.
    """
    values, positions = set(), []
    for index, part in enumerate(parts):
        match = _EXPOSURE.fullmatch(part)
        if match is None:
            continue
        positions.append(index)
        before = parts[index - 1] if index else ""
        # '1-30s' and '1_4s': a fraction, a decimal, or a repeat and whole seconds
        ambiguous = before.isdigit() and len(before) <= _MAX_REPEAT_DIGITS
        values.add(None if ambiguous else float(match[1].replace(",", ".")) * _UNIT_S[match[2]])
    value = values.pop() if len(values) == 1 else None
    return (value if value is not None and value > 0 else None), positions


def _filter(parts: list[str], has_words: bool) -> tuple[str | None, list[int]]:
    """The filter, and the positions of parts that look like one; None if several differ."""
    matches = {k: m[1] or m[2] for k, part in enumerate(parts) if (m := _FILTER.fullmatch(part))}
    if not matches and not has_words:
        matches = {k: part for k, part in enumerate(parts) if _BARE_FILTER.fullmatch(part)}
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


def parse_name(stem: str, ignored: int = 0) -> FrameName:
    """Read the name of a frame.

    Parameters
    ----------
    stem
        Name of the file without its ending.
    ignored
        Number of first words that all names share, see ``common_words``.

    Returns
    -------
    FrameName
        What the name says with certainty.
    """
    text = _DATE.sub(" ", stem.lower())
    dated = text != stem.lower()
    parts = [part for part in _SEPARATORS.split(text) if part.strip(".,")]
    parts = [piece for part in parts[ignored:] for piece in _without_number(part)]
    kinds = [_kind_of_word(part) for part in parts]
    # a kind after the first part is a word: 'box-flat' may be a flat of the box or a box that is flat
    certain = bool(kinds) and kinds[0] is not None and all(other in (None, kinds[0]) for other in kinds)
    exposure, exposure_parts = _exposure(parts)
    other_words = tuple(
        part
        for index, part in enumerate(parts)
        if not (part.isdigit() or index in exposure_parts or _FILTER.fullmatch(part))
        and not (certain and (kinds[index] is not None or part in _FILLERS))
    )
    # a number alone may count photographs: it is a filter only next to an exposure, a kind or a date
    alone = not (exposure_parts or certain or dated)
    band, filter_parts = _filter(parts, bool(other_words) or bool(ignored) or alone)
    repeat, last = None, len(parts) - 1
    is_number = last >= 0 and parts[last].isdigit() and len(parts[last]) <= _MAX_REPEAT_DIGITS
    if is_number and last + ignored > 0 and last not in filter_parts:
        repeat = int(parts[last])
    series = re.sub(r"[-_\s(\[]*\d+[)\]]?$", "", stem) if repeat is not None else stem
    return FrameName(stem, kinds[0] if certain else None, band, exposure, repeat, other_words, series)


def _without_number(part: str) -> tuple[str, ...]:
    """A kind and the number behind it, such as 'dark01', as two parts; other parts as they are."""
    match = _NUMBERED_KIND.fullmatch(part)
    return (match[1], match[2]) if match is not None and _kind_of_word(match[1]) is not None else (part,)
