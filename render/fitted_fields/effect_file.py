"""Effect files (TOML): a fitted field as an effect with one parameter, its amplitude.

A model names the effect by the path of the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import validated
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_toml
from pydantic import BaseModel, ConfigDict, Field

from ..effects import Effect
from .acting import field_effect
from .fitted_field import field_of_record

__all__ = ["effect_text", "load_effect_file", "write_effect_file"]

#: Format and version of effect files, the value of their key ``format``.
_FORMAT = "effect/1"


class _EffectFile(BaseModel):
    """Content of an effect file."""

    model_config = ConfigDict(extra="forbid", strict=True)

    format: str
    title: str = Field("", max_length=50)
    summary: str = ""
    field: dict[str, Any]


def load_effect_file(path: Path) -> Effect:
    """Effect of an effect file.

    Parameters
    ----------
    path
        The file, TOML of format "effect/1".

    Returns
    -------
    Effect
        The effect. Its identifier is the file's name without the ending.

    Raises
    ------
    InputError
        If the file is missing or faulty; all faults of its keys are named.
    """
    content = read_toml(path, "an effect file in TOML, made from a diagnosis")
    entry = validated(path, content, _EffectFile)
    if entry.format != _FORMAT:
        raise InputError(f"{path}: format", f"'{entry.format}'", f"'{_FORMAT}'")
    field = field_of_record(entry.field, path)
    effect = field_effect(path.stem, field, entry.title, entry.summary or entry.title or "a fitted field")
    return replace(effect, file=path.resolve())


def effect_text(title: str, summary: str, record: Mapping[str, Any]) -> str:
    """Content of an effect file.

    Parameters
    ----------
    title
        Description for lists, at most 50 characters; may be empty.
    summary
        Description for users; may be empty.
    record
        The field as ``field_record`` gives it.

    Returns
    -------
    str
        TOML, with a comment that explains the amplitude.
    """
    lines = ["# An effect of one number, amplitude: 1 as fitted, 0 nothing. A model names it by this file's path."]
    lines += [
        f"format = {json.dumps(_FORMAT)}",
        f"title = {json.dumps(title)}",
        f"summary = {json.dumps(summary)}",
    ]
    plain = {key: value for key, value in record.items() if key not in ("image", "surfaces")}
    lines += ["", "[field]", *_pairs(plain)]
    if "image" in record:
        lines += ["", "[field.image]", *_pairs(record["image"])]
    for surface_map in record.get("surfaces", ()):
        lines += ["", "[[field.surfaces]]", *_pairs(surface_map)]
    return "\n".join(lines) + "\n"


def _pairs(values: Mapping[str, Any]) -> list[str]:
    """Lines of TOML; numbers, texts and lists are written in TOML as in JSON."""
    return [f"{key} = {json.dumps(value)}" for key, value in values.items()]


def write_effect_file(path: Path, title: str, summary: str, record: Mapping[str, Any]) -> Effect:
    """Write an effect file, complete or not at all, and read it back.

    Parameters
    ----------
    path
        The effect file, .toml. An existing file is replaced.
    title
        Description for lists, at most 50 characters; may be empty.
    summary
        Description for users; may be empty.
    record
        The field as ``field_record`` gives it.

    Returns
    -------
    Effect
        The effect of the file.

    Raises
    ------
    InputError
        If the record is not a field.
    """
    field_of_record(record, path)
    with replacing(path) as temporary:
        temporary.write_text(effect_text(title, summary, record), encoding="utf-8")
    return load_effect_file(path)
