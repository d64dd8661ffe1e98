"""Model files (TOML): a scene, the effects added to it in order, and render settings."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tomli_w
from cboxlab.scenes import Scene, cornell_box
from cboxlab.scenes.scene_file import load_scene, packaged_scenes
from cboxlab.utils.arguments import described, required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion, validated
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_toml
from pydantic import BaseModel, ConfigDict, Field

from ..chain import RenderSettings
from ..effects import AppliedEffect, Effect, apply_checked, names_in
from ..fitted_fields import load_effect_file

__all__ = [
    "Model",
    "checked_effects",
    "load_model",
    "model_text",
    "named_effect",
    "referred_scene",
    "scene_reference",
    "with_scene_file",
    "write_model",
]


@dataclass(frozen=True)
class Model:
    """A scene with the effects that it is thought to have, and render settings.

    A model is a value: files that it was read from may change or vanish afterwards.

    Examples
    --------
    >>> import cboxlab
    >>> model = cboxlab.load_model("cornell-box").with_effect("veiling-glare", fraction=0.01)
    >>> [effect.id for effect in model.effects]
    ['veiling-glare']
    """

    #: The scene; its ``origin`` says where it was read from.
    scene: Scene = field(default_factory=cornell_box)
    #: Effects in the order in which they act.
    effects: tuple[AppliedEffect, ...] = ()
    #: Noise, number of reflections and seed of its rendering.
    render: RenderSettings = field(default_factory=RenderSettings)
    #: Title of the model.
    name: str = "published box"

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that the model was read from: scene, tables, meshes and effects.

        Files of packaged scenes are not included.
        """
        scene = () if self.scene.origin is None else self.scene.origin.files
        return *scene, *(e.effect.file for e in self.effects if e.effect.file is not None)

    def with_effect(self, effect: AppliedEffect | Effect | str, **values: float | str) -> Model:
        """Copy of the model with one more effect.

        Parameters
        ----------
        effect
            An effect with its parameters, an effect, its identifier, or an effect file (.toml).
        **values
            Parameters by name, such as ``fraction=0.01``; those left out have their default or null value.

        Returns
        -------
        Model
            The model with the effect added last.

        Raises
        ------
        InputError
            If there is no such effect, or a parameter is unknown or out of range.
        """
        if isinstance(effect, AppliedEffect) and not values:
            return replace(self, effects=(*self.effects, effect))
        if not isinstance(effect, Effect | str):
            expected = "an effect, its identifier, or an effect file (.toml)"
            raise InputError("Model.with_effect", described(effect), expected)
        effect_or_name = effect if isinstance(effect, Effect) else named_effect(effect, Path())
        applied = apply_checked(effect_or_name, values, "Model.with_effect", names_in(self.scene))
        return replace(self, effects=(*self.effects, applied))


class _Strict(BaseModel):
    """Table without unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True)


class _Render(_Strict):
    """Table ``[render]``, see ``RenderSettings``."""

    noise: float = Field(0.3, gt=0, le=10)
    max_bounces: int | None = Field(None, ge=0)
    seed: int = Field(0, ge=0)


class _ModelFile(_Strict):
    """Content of a model file."""

    format: str
    name: str = ""
    scene: str = "cornell-box"
    render: _Render = Field(default_factory=lambda: _Render.model_validate({}))
    effect: list[dict[str, Any]] = Field(default_factory=list)


def load_model(path_or_name: str | Path) -> Model:
    """Model of a file, or a scene without effects.

    Parameters
    ----------
    path_or_name
        A model file, a scene file, or the name of a packaged scene such as "cornell-box".

    Returns
    -------
    Model
        The model, with everything that its files state.

    Raises
    ------
    InputError
        If a file is missing or faulty; all faults are named.

    Examples
    --------
    >>> import cboxlab
    >>> cboxlab.load_model("cornell-box").scene.lamp.surface.name
    'light'
    """
    path = required_path("load_model", path_or_name, "a model file, a scene file or a packaged scene's name")
    if str(path_or_name) in packaged_scenes():
        return Model(load_scene(path_or_name), name=str(path_or_name))
    names = packaged_scenes()
    hint = suggestion(str(path), names) or f"Packaged scenes: {', '.join(names)}"
    content = read_toml(path, "a model or scene file in TOML", hint)
    if content.get("format") == "scene/1":
        scene = load_scene(path)
        return Model(scene, name=scene.name)
    entry = validated(path, content, _ModelFile)
    if entry.format != "model/1":
        raise InputError(f"{path}: format", f"'{entry.format}'", "'model/1'")
    scene = referred_scene(entry.scene, path.parent)
    effects = checked_effects(entry.effect, scene, f"{path}: effect", path.parent)
    settings = RenderSettings(entry.render.noise, entry.render.max_bounces, entry.render.seed)
    return Model(scene, effects, settings, entry.name or path.stem)


def referred_scene(reference: str, folder: Path) -> Scene:
    """Scene that a file refers to.

    Parameters
    ----------
    reference
        Name of a packaged scene, or a scene file (.toml) relative to ``folder``.
    folder
        Folder of the file that refers to it.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    InputError
        If the scene cannot be read.
    """
    return load_scene((folder / reference).resolve() if reference.endswith(".toml") else reference)


def scene_reference(scene: Scene, folder: Path | None) -> str:
    """Text by which a file in a folder refers to a scene.

    Parameters
    ----------
    scene
        Any scene.
    folder
        Folder of the file that will refer to it; None for absolute paths.

    Returns
    -------
    str
        Name of the packaged scene, or the scene file's path relative to ``folder``. For a scene that was built or
        changed in memory a description, which no file can refer to: see ``with_scene_file``.
    """
    if scene.origin is None:
        return f"in memory: {scene.name}"
    if scene.origin.packaged or folder is None:
        return scene.origin.reference
    return Path(os.path.relpath(scene.origin.reference, folder.resolve())).as_posix()


def with_scene_file(model: Model, path: Path) -> Model:
    """Model whose scene is in a file.

    Parameters
    ----------
    model
        Any model.
    path
        File to which a scene that was built or changed in memory is written, .toml.

    Returns
    -------
    Model
        The same model where its scene has an origin.

    Raises
    ------
    InputError
        If the scene has a property that scene files cannot state.
    """
    return model if model.scene.origin is not None else replace(model, scene=load_scene(model.scene.write(path)))


def checked_effects(
    entries: Sequence[Mapping[str, Any]], scene: Scene, where: str, folder: Path
) -> tuple[AppliedEffect, ...]:
    """Effects of the entries of a file, with checked values.

    Parameters
    ----------
    entries
        Tables with ``id``, values of parameters, and standard deviations ``sigma``. An ``id`` that ends in .toml is an
        effect file.
    scene
        Scene whose materials, surfaces and blocks the effects may name.
    where
        File and key for errors; an error is reported at ``where[index]``.
    folder
        Folder to which effect files are relative.

    Returns
    -------
    tuple[AppliedEffect, ...]
        The effects, in the order of the entries.

    Raises
    ------
    InputError
        If an effect or parameter is unknown, a value out of bounds, or ``sigma`` not a table of numbers of 0 or more.
    """
    names = names_in(scene) if entries else {}
    effects = []
    for index, entry in enumerate(entries):
        values, key = dict(entry), f"{where}[{index}]"
        identifier = values.pop("id", None)
        sigma = _checked_sigma(values.pop("sigma", {}), f"{key}.sigma")
        effect = named_effect(identifier, folder)
        effects.append(replace(apply_checked(effect, values, key, names), sigma=sigma))
    return tuple(effects)


def named_effect(name: str | None, folder: Path) -> str | Effect | None:
    """Effect of a name that is the path of an effect file.

    Parameters
    ----------
    name
        Path of an effect file, .toml, or an identifier.
    folder
        Folder to which the path is relative.

    Returns
    -------
    str, Effect or None
        The effect of the file; ``name`` itself if it does not end in .toml.

    Raises
    ------
    InputError
        If the effect file is missing or faulty.
    """
    is_file = isinstance(name, str) and name.endswith(".toml")
    return load_effect_file(folder / str(name)) if is_file else name


def _checked_sigma(sigma: Any, where: str) -> dict[str, float]:
    """Standard deviations by parameter; InputError for anything except a table of numbers."""
    if not isinstance(sigma, dict) or not all(isinstance(v, int | float) and v >= 0 for v in sigma.values()):
        raise InputError(where, repr(sigma), "a table of standard deviations, such as { fraction = 1e-4 }")
    return {key: float(value) for key, value in sigma.items()}


def model_text(model: Model, folder: Path | None = None) -> str:
    """Content of a model's file.

    Parameters
    ----------
    model
        Any model; of a scene in memory the text describes it and cannot be loaded.
    folder
        Folder in which the file is to lie; None names files by their absolute paths.

    Returns
    -------
    str
        TOML.
    """
    settings = {"noise": model.render.noise, "max_bounces": model.render.max_bounces, "seed": model.render.seed}
    content: dict[str, Any] = {
        "format": "model/1",
        "name": model.name,
        "scene": scene_reference(model.scene, folder),
        "render": {key: value for key, value in settings.items() if value is not None},
    }
    effects = [_effect_table(effect, folder) for effect in model.effects]
    return tomli_w.dumps({**content, "effect": effects} if effects else content)


def _effect_table(effect: AppliedEffect, folder: Path | None) -> dict[str, Any]:
    """Entry of an effect in a model file."""
    values = {key: value if isinstance(value, str) else float(value) for key, value in effect.values.items()}
    sigma = {"sigma": {key: float(value) for key, value in effect.sigma.items()}} if effect.sigma else {}
    return {"id": effect.name_below(folder), **values, **sigma}


def write_model(path: Path, model: Model) -> None:
    """Write a model file, complete or not at all.

    A scene that was built or changed in memory is written next to it, as STEM-scene.toml.

    Parameters
    ----------
    path
        The model file, .toml: a new one, or a model file, which is replaced.
    model
        The model; ``load_model`` reads the same model back.

    Raises
    ------
    InputError
        If a file of another kind would be replaced, or the scene has a property that scene files cannot state.
    """
    path = required_path("path", path, "a model file to write")
    if path.exists() and read_toml(path, "a model file in TOML").get("format") != "model/1":
        raise InputError(path, "a file that is no model file", "a new file or a model file", "Name another one.")
    model = with_scene_file(model, path.with_name(f"{path.stem}-scene.toml"))
    with replacing(path) as temporary:
        temporary.write_text(model_text(model, path.parent), encoding="utf-8")
