"""Settings that capture programs write into a text file next to their frames."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from ._frame_reader import FrameFacts

__all__ = ["settings_of", "with_settings"]

#: Names of such files of SharpCap and FireCapture, by that of the frame without its ending and without its number.
_NAMES = ("{0}.CameraSettings.txt", "{0}.txt", "{1}.txt")
#: Number of a frame at the end of its name.
_NUMBER = re.compile(r"_\d+$")
#: Keys of these programs, in small letters, by fact.
_KEYS = {
    "exposure_s": ("exposure", "shutter"),
    "filter": ("filter", "filterwheel"),
    "kind": ("frametype",),
    "time": ("startcapture",),
}
#: An exposure with its unit, and seconds in the unit.
_EXPOSURE = re.compile(r"(\d+(?:\.\d+)?)\s*(us|µs|ms|s)")
_UNIT_S = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
#: Values that name no filter.
_NO_FILTER = ("", "none", "no filter", "dark", "l")
#: Largest size of a settings file, bytes.
_MOST_BYTES = 2**16


def settings_of(path: Path) -> Path | None:
    """Settings file next to a frame.

    Parameters
    ----------
    path
        The frame.

    Returns
    -------
    Path or None
        None where there is none.
    """
    stem = path.name.partition(".")[0] if path.name.count(".") == 1 else path.stem
    names = [name.format(stem, _NUMBER.sub("", stem)) for name in _NAMES]
    return next((file for name in names if (file := path.with_name(name)).is_file() and file != path), None)


def with_settings(path: Path, facts: FrameFacts) -> FrameFacts:
    """Facts of a frame, completed by its settings file.

    Parameters
    ----------
    path
        The frame.
    facts
        What the frame's file itself states, which stays.

    Returns
    -------
    FrameFacts
        With exposure, filter, kind and time of the settings file where the frame states none.
    """
    file = settings_of(path)
    if file is None or file.stat().st_size > _MOST_BYTES:
        return facts
    text = file.read_bytes().decode("utf-8", "replace")
    pairs = {
        key.strip().lower(): value.strip() for key, _, value in (line.partition("=") for line in text.splitlines())
    }
    texts = {fact: next((pairs[key] for key in keys if key in pairs), "") for fact, keys in _KEYS.items()}
    exposure, kind = _EXPOSURE.fullmatch(texts["exposure_s"]), texts["kind"].lower()
    values: dict[str, Any] = {
        "exposure_s": float(exposure[1]) * _UNIT_S[exposure[2]] if exposure and float(exposure[1]) > 0 else None,
        "filter": None if texts["filter"].lower() in _NO_FILTER else texts["filter"],
        "kind": kind or None,
        "time": _time(texts["time"]),
    }
    return replace(facts, **{key: value for key, value in values.items() if getattr(facts, key) is None})


def _time(text: str) -> datetime | None:
    """Moment without time zone; None for anything else than date and time."""
    try:
        return datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError:
        return None
