"""Model files (TOML): a scene, the effects added to it in order, and render settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cboxlab.scenes.scene_file import load_scene, packaged_scenes, scene_files
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, faults_of_validation
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_toml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..chain import RenderSettings
from ..effects import AppliedEffect, Effect, apply_checked, names_in
from ..fitted_fields import load_effect_file

__all__ = ["Model", "checked_effects", "load_model", "model_text", "named_effect", "write_model"]


@dataclass(frozen=True)
class Model:
    """scene : a packaged scene's name or a scene file's path."""

    scene: str = "cornell-box"
    effects: tuple[AppliedEffect, ...] = ()
    render: RenderSettings = field(default_factory=RenderSettings)
    name: str = "published box"

    @property
    def files(self) -> tuple[Path, ...]:
        """The scene file, its tables and meshes, and the effect files; none of what comes with the program."""
        scene = () if self.scene in packaged_scenes() else scene_files(Path(self.scene))
        return *scene, *(e.effect.file for e in self.effects if e.effect.file is not None)

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


def load_model(path_or_name: str | Path) -> Model:
    """The model of a file, or a scene without effects: a packaged one by name ("cornell-box"), or a scene file.

    Raises InputError naming every fault.
    """
    if str(path_or_name) in packaged_scenes():
        return Model(scene=str(path_or_name), name=str(path_or_name))
    path = Path(path_or_name)
    content = read_toml(path, "a model file in TOML")
    if content.get("format") == "scene/1":
        return Model(scene=str(path.resolve()), name=load_scene(path).name)
    try:
        entry = _ModelFile.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _ModelFile)) from None
    if entry.format != "model/1":
        raise InputError(f"{path}: format", f"'{entry.format}'", "'model/1'")
    scene = entry.scene
    if scene.endswith(".toml"):
        scene = str((path.parent / scene).resolve())
    effects = checked_effects(entry.effect, scene, f"{path}: effect", path.parent)
    settings = RenderSettings(entry.render.noise, entry.render.max_bounces, entry.render.seed)
    return Model(scene, effects, settings, entry.name or path.stem)


def checked_effects(
    entries: Sequence[Mapping[str, Any]], scene: str, where: str, folder: Path
) -> tuple[AppliedEffect, ...]:
    """The effects of a file's entries, each a table of ``id``, values and ``sigma``, in a scene by name or path.

    An ``id`` that ends in .toml is an effect file, relative to ``folder``.

    Raises InputError (at ``where[index]``) for an entry that is none.
    """
    names = names_in(load_scene(scene)) if entries else {}
    effects = []
    for index, entry in enumerate(entries):
        values, place = dict(entry), f"{where}[{index}]"
        identifier = values.pop("id", None)
        sigma = _checked_sigma(values.pop("sigma", {}), f"{place}.sigma")
        known = named_effect(identifier, folder)
        effects.append(replace(apply_checked(known, values, place, names), sigma=sigma))
    return tuple(effects)


def named_effect(name: str | None, folder: Path) -> str | Effect | None:
    """The effect of the file that a name is, relative to ``folder``; the name itself where it is none of a file."""
    is_file = isinstance(name, str) and name.endswith(".toml")
    return load_effect_file(folder / str(name)) if is_file else name


def _checked_sigma(sigma: Any, where: str) -> dict[str, float]:
    """Standard deviations by parameter. Raises InputError for anything but a table of numbers."""
    if not isinstance(sigma, dict) or not all(isinstance(v, int | float) and v >= 0 for v in sigma.values()):
        raise InputError(where, repr(sigma), "a table of standard deviations, such as { fraction = 1e-4 }")
    return {key: float(value) for key, value in sigma.items()}


def model_text(model: Model, folder: Path | None = None) -> str:
    """The content of the model's file. folder : in which it is to lie; None names files by their whole paths."""
    lines = [
        'format = "model/1"',
        f"name = {_toml(model.name)}",
        f"scene = {_toml(model.scene)}",
        "",
        "[render]",
        f"noise = {model.render.noise!r}",
    ]
    if model.render.max_bounces is not None:
        lines.append(f"max_bounces = {model.render.max_bounces}")
    lines.append(f"seed = {model.render.seed}")
    for effect in model.effects:
        lines += ["", "[[effect]]", f"id = {_toml(effect.name_below(folder))}"]
        lines += [f"{key} = {_toml(value)}" for key, value in effect.values.items()]
        if effect.sigma:
            lines.append("sigma = { " + ", ".join(f"{k} = {float(v)!r}" for k, v in effect.sigma.items()) + " }")
    return "\n".join(lines) + "\n"


def write_model(path: Path, model: Model) -> None:
    """Write a model file, complete or not at all; ``load_model`` reads the same model back."""
    with replacing(path) as temporary:
        temporary.write_text(model_text(model, path.parent), encoding="utf-8")


def _toml(value: str | float) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(float(value))
