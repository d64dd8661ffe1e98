"""The model file: a scene, the effects added to it in order, and how to render. One TOML a person can edit."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import combined, faults_of_validation
from cboxlab.scenes.files import replacing
from cboxlab.scenes.scene_file import load_scene
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .effects import AppliedEffect, apply_checked, names_in

__all__ = ["Model", "RenderSettings", "load_model", "write_model"]


@dataclass(frozen=True)
class RenderSettings:
    """noise : render's standard deviation over the sensor's, median over pixels and bands, to render down to.

    max_bounces : reflections between lamp and camera, None for all. seed : of every random number.
    """

    noise: float = 0.3
    max_bounces: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class Model:
    """scene : a packaged scene's name or a scene file's path."""

    scene: str = "cornell-box"
    effects: tuple[AppliedEffect, ...] = ()
    render: RenderSettings = RenderSettings()
    name: str = "published box"

    def with_effect(self, effect: AppliedEffect) -> Model:
        """The model with one more effect."""
        return replace(self, effects=(*self.effects, effect))


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Render(_Strict):
    noise: float = Field(0.3, gt=0, le=10)
    max_bounces: int | None = Field(None, ge=0)
    seed: int = Field(0, ge=0)


class _ModelFile(_Strict):
    format: str
    name: str = ""
    scene: str = "cornell-box"
    render: _Render = Field(default_factory=lambda: _Render.model_validate({}))
    effect: list[dict[str, Any]] = Field(default_factory=list)


def load_model(path: Path) -> Model:
    """Read a model file. Raises InputError naming every fault."""
    try:
        with open(path, "rb") as stream:
            content = tomllib.load(stream)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a readable model file (TOML)") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"no TOML: {error}", "a model file (TOML)") from None
    try:
        entry = _ModelFile.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _ModelFile)) from None
    if entry.format != "model/1":
        raise InputError(f"{path}: format", f"'{entry.format}'", "'model/1'")
    scene = entry.scene
    if scene.endswith(".toml"):
        scene = str((path.parent / scene).resolve())
    names = names_in(load_scene(scene)) if entry.effect else {}
    effects = []
    for index, item in enumerate(entry.effect):
        values = dict(item)
        identifier, where = values.pop("id", None), f"{path}: effect[{index}]"
        sigma = _checked_sigma(values.pop("sigma", {}), f"{where}.sigma")
        effects.append(replace(apply_checked(identifier, values, where, names), sigma=sigma))
    settings = RenderSettings(entry.render.noise, entry.render.max_bounces, entry.render.seed)
    return Model(scene, tuple(effects), settings, entry.name or path.stem)


def _checked_sigma(sigma: Any, where: str) -> dict[str, float]:
    """Standard deviations, told and passed on. Raises InputError for anything but a table of numbers."""
    if not isinstance(sigma, dict) or not all(isinstance(v, int | float) and v >= 0 for v in sigma.values()):
        raise InputError(where, repr(sigma), "a table of standard deviations, such as { fraction = 1e-4 }")
    return {key: float(value) for key, value in sigma.items()}


def write_model(path: Path, model: Model) -> None:
    """Write a model file, complete or not at all; ``load_model`` reads the same model back."""
    lines = ['format = "model/1"', f"name = {_toml(model.name)}", f"scene = {_toml(model.scene)}", "", "[render]",
             f"noise = {model.render.noise!r}"]  # fmt: skip
    if model.render.max_bounces is not None:
        lines.append(f"max_bounces = {model.render.max_bounces}")
    lines.append(f"seed = {model.render.seed}")
    for effect in model.effects:
        lines += ["", "[[effect]]", f"id = {_toml(effect.id)}"]
        lines += [f"{key} = {_toml(value)}" for key, value in effect.values.items()]
        if effect.sigma:
            lines.append(
                "sigma = { " + ", ".join(f"{k} = {float(v)!r}" for k, v in effect.sigma.items()) + " }"
            )
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _toml(value: str | float) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(float(value))
