"""Effect files (TOML): a fitted field as an effect of one amplitude, that a model names by the file's path."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, faults_of_validation
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_toml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..effects import Effect
from .acting import field_effect
from .fitted_field import field_of_record

__all__ = ["effect_text", "load_effect_file", "write_effect_file"]

_FORMAT = "effect/1"


class _EffectFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: str
    title: str = Field("", max_length=50)
    summary: str = ""
    field: dict[str, Any]


def load_effect_file(path: Path) -> Effect:
    """The effect of a file; its identifier is the file's name without the ending.

    Raises InputError naming every fault.
    """
    content = read_toml(path, "an effect file in TOML, made from a diagnosis")
    try:
        entry = _EffectFile.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _EffectFile)) from None
    if entry.format != _FORMAT:
        raise InputError(f"{path}: format", f"'{entry.format}'", f"'{_FORMAT}'")
    field = field_of_record(entry.field, path)
    effect = field_effect(path.stem, field, entry.title, entry.summary or entry.title or "a fitted field")
    return replace(effect, file=path.resolve())


def effect_text(title: str, summary: str, record: Mapping[str, Any]) -> str:
    """The content of an effect file. record : of its field, see ``field_record``."""
    lines = ["# An effect of one number, amplitude: 1 as found, 0 nothing. A model names it by this file's path."]
    lines += [
        f"format = {json.dumps(_FORMAT)}",
        f"title = {json.dumps(title)}",
        f"summary = {json.dumps(summary)}",
    ]
    own = {key: value for key, value in record.items() if key not in ("image", "surfaces")}
    lines += ["", "[field]", *_pairs(own)]
    if "image" in record:
        lines += ["", "[field.image]", *_pairs(record["image"])]
    for one in record.get("surfaces", ()):
        lines += ["", "[[field.surfaces]]", *_pairs(one)]
    return "\n".join(lines) + "\n"


def _pairs(values: Mapping[str, Any]) -> list[str]:
    """Numbers, texts and lists look alike in JSON and TOML."""
    return [f"{key} = {json.dumps(value)}" for key, value in values.items()]


def write_effect_file(path: Path, title: str, summary: str, record: Mapping[str, Any]) -> Effect:
    """Write an effect file, complete or not at all, and read it back.

    Raises InputError where the record is no field.
    """
    field_of_record(record, path)
    with replacing(path) as temporary:
        temporary.write_text(effect_text(title, summary, record), encoding="utf-8")
    return load_effect_file(path)
