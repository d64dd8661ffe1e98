"""Study file (study.json): captures, model and all states of a study."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import Model, checked_effects, referred_scene, scene_reference, with_scene_file
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import validated
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_json
from pydantic import BaseModel, ConfigDict, Field

from .history import History, State

__all__ = ["StudyFile", "read_study", "write_study"]

#: Text for an infinite value, which JSON does not have.
_INFINITE = "inf"


@dataclass(frozen=True, eq=False)
class StudyFile:
    """Content of a study file."""

    #: Folders of the captures.
    captures: tuple[Path, ...]
    #: Scene and settings, with the effects of the present state.
    model: Model
    #: All states.
    history: History


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Render(_Strict):
    noise: float = Field(gt=0, le=10)
    max_bounces: int | None = Field(ge=0)
    seed: int = Field(ge=0)


class _State(_Strict):
    effects: list[dict[str, Any]]
    rendered_with: list[dict[str, Any]]


class _Content(_Strict):
    format: Literal["study/1"]
    captures: list[str] = Field(min_length=1)
    name: str
    scene: str
    render: _Render
    states: list[_State] = Field(min_length=1)
    at: int = Field(ge=0)


def write_study(path: Path, study: StudyFile) -> None:
    """Write a study file, complete or not at all.

    Captures and a scene file are named relative to its folder. A scene in memory is written next to it.

    Parameters
    ----------
    path
        File to write.
    study
        Its content.
    """
    model = with_scene_file(study.model, path.with_name(f"{path.stem}-scene.toml"))
    folder = path.parent.resolve()
    content = {
        "format": "study/1",
        "captures": [_relative(capture, folder) for capture in study.captures],
        "name": model.name,
        "scene": scene_reference(model.scene, folder),
        "render": {
            "noise": model.render.noise,
            "max_bounces": model.render.max_bounces,
            "seed": model.render.seed,
        },
        "states": [
            {"effects": _entries(state.effects, folder), "rendered_with": _entries(state.rendered_with, folder)}
            for state in study.history.states
        ],
        "at": study.history.at,
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_study(path: Path) -> StudyFile:
    """A study from a file of `write_study`.

    Parameters
    ----------
    path
        File to read.

    Returns
    -------
    StudyFile
        With absolute paths.

    Raises
    ------
    InputError
        Naming every fault of the file.
    """
    entry = validated(path, read_json(path, "a study in JSON"), _Content)
    if entry.at >= len(entry.states):
        raise InputError(f"{path}: at", str(entry.at), f"below the number of states, {len(entry.states)}")
    parent = path.parent
    scene = referred_scene(entry.scene, parent)
    states = tuple(
        State(
            checked_effects(_read(state.effects), scene, f"{path}: states[{index}].effects", parent),
            checked_effects(_read(state.rendered_with), scene, f"{path}: states[{index}].rendered_with", parent),
        )
        for index, state in enumerate(entry.states)
    )
    settings = RenderSettings(entry.render.noise, entry.render.max_bounces, entry.render.seed)
    history = History(states, entry.at)
    model = Model(scene, history.present.effects, settings, entry.name)
    return StudyFile(tuple((parent / capture).resolve() for capture in entry.captures), model, history)


def _relative(path: Path, folder: Path) -> str:
    """A path relative to a folder, with slashes."""
    return Path(os.path.relpath(path.resolve(), folder)).as_posix()


def _entries(effects: Sequence[AppliedEffect], folder: Path) -> list[dict[str, Any]]:
    """Effects as entries for JSON, infinite values as text."""
    entries = []
    for effect in effects:
        values = {key: _INFINITE if value == math.inf else value for key, value in effect.values.items()}
        sigma = {"sigma": dict(effect.sigma)} if effect.sigma else {}
        entries.append({"id": effect.name_below(folder), **values, **sigma})
    return entries


def _read(entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Entries of JSON with infinite values as numbers."""
    return [{key: math.inf if value == _INFINITE else value for key, value in entry.items()} for entry in entries]
