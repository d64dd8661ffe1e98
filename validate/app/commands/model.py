"""Commands on models: add an effect, show the catalogue."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.files import folder_lock
from cboxlab.utils.progress import share
from rich.table import Table
from rich.text import Text

from .console import JsonOption, bar, console, give_json, options, require_folder, say

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cboxlab.rendering.effects import AppliedEffect, Effect
    from cboxlab.rendering.model import Model

__all__ = ["add", "complete_effect", "effects"]


def complete_effect(incomplete: str) -> list[str]:
    """Identifiers for the shell's completion."""
    from cboxlab.rendering.effects import catalogue

    return [name for name in catalogue() if name.startswith(incomplete)]


def add(
    model: Annotated[Path, typer.Argument(help="Model file (TOML); created if it does not exist.", show_default=False)],
    effect: Annotated[
        str,
        typer.Argument(
            help="Identifier, see `cbox effects`, or an effect file (.toml).",
            show_default=False,
            autocompletion=complete_effect,
        ),
    ],
    values: Annotated[list[str] | None, typer.Argument(help="key=value ...", show_default=False)] = None,
    fit: Annotated[
        Path | None,
        typer.Option(help="Fit the omitted parameters to this capture, together with camera and lamp."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Scene file or packaged scene of a model that is created; with --fit default the capture's."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Add an effect to a model; omitted parameters get their default or null value, or are fitted."""
    from cboxlab.rendering.effects import apply_checked, names_in
    from cboxlab.rendering.model import Model, load_model, named_effect, write_model
    from cboxlab.scenes.scene_file import load_scene, packaged_scenes

    from ...api import as_model

    if model.suffix != ".toml":
        raise InputError(model, f"the ending '{model.suffix}'", "a model file, '.toml'")
    given = dict(_pair(text) for text in values or ())
    found = _content(model)
    if scene is not None and model.exists():
        raise InputError("--scene", f"'{scene}', and {model} exists", "no scene: the model has one")
    current = load_model(model) if model.exists() else Model(name=model.stem)
    if current.scene == str(model.resolve()):
        raise InputError(model, "a scene file", "a model file", f"Name a new one, with --scene {model}.")
    if scene is None and fit is not None and not model.exists():
        current = replace(current, scene=as_model(None, [fit]).scene)
    if scene is not None:
        current = replace(current, scene=scene if scene in packaged_scenes() else str(Path(scene).resolve()))
    known = named_effect(effect, Path())
    applied = apply_checked(known, given, "cbox add", names_in(load_scene(current.scene)))
    before_after: dict[str, float] = {}
    if fit is not None:
        require_folder(model.parent)
        applied, before_after = _fitted(fit, current, applied.effect, given)
    if current.scene.endswith(".toml"):
        current = replace(current, scene=Path(os.path.relpath(current.scene, model.parent)).as_posix())
    grown = current.with_effect(applied)
    model.parent.mkdir(parents=True, exist_ok=True)
    with folder_lock(model.parent):
        if _content(model) != found:
            raise InputError(
                model,
                "another content than when the command began",
                "a model that nothing else changes",
                "Run it again.",
            )
        write_model(model, grown)
    shown = ", ".join(
        f"{key} = {value if isinstance(value, str) else format(value, '.5g')}"
        + (f" ± {applied.sigma[key]:.2g}" if key in applied.sigma else "")
        for key, value in applied.values.items()
    )
    own = {"effect": applied.id, "parameters": dict(applied.values), "sigma": dict(applied.sigma)}
    give_json(json, {"model": model, "added": own, "effects": [e.id for e in grown.effects], **before_after})
    say(f"{model}: added {applied.id} ({shown}); effects now: {', '.join(e.id for e in grown.effects)}")


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None


def _fitted(
    capture: Path, model: Model, effect: Effect, given: dict[str, str | float]
) -> tuple[AppliedEffect, dict[str, float]]:
    """The fitted effect, and chi-square per sample before and after as keys of the record."""
    from ...api import Study
    from ...diagnose import fit_effect
    from ...predict import default_cache

    with options(fit="--fit"), bar(f"fitting {effect.id}") as report:
        study = Study.open(capture, model=model, cache=default_cache(), progress=share(report, 0.0, 0.8))
        applied, before, after = fit_effect(study.validations()[0], effect, given, share(report, 0.8, 1.0))
    say(f"χ² per sample: {before:.4g} without the effect, {after:.4g} with it, camera and lamp fitted")
    return applied, {"chi2_per_sample_before": before, "chi2_per_sample": after}


def _pair(text: str) -> tuple[str, str | float]:
    key, separator, value = text.partition("=")
    if not separator or not key or not value:
        raise InputError("cbox add", repr(text), "key=value, such as fraction=0.02")
    try:
        return key, float(value)
    except ValueError:
        return key, value


def _print_list(known: Mapping[str, Effect]) -> None:
    """One line for each effect, by the stage of the chain at which it acts, in the order of light."""
    from cboxlab.rendering.chain import STAGES

    width = max(len(name) for name in known)
    for stage in STAGES:
        for index, effect in enumerate(e for e in known.values() if e.stage == stage):
            say(f"{stage if index == 0 else '':<{max(map(len, STAGES))}} {effect.id:<{width}} {effect.in_few_words}")
    say("One effect with its parameters: cbox effects ID")


def _write_new(path: Path, diagnosis: Path, json: Path | None) -> None:
    from cboxlab.rendering.fitted_fields import effect_of_diagnosis

    require_folder(path.parent)
    with options(**{"name of the effect": "--new"}):
        effect, caution = effect_of_diagnosis(path, diagnosis)
    give_json(json, {"file": path, "caution": caution, **effect.to_dict()})
    say(f"{path}: {effect.in_few_words}")
    if caution:
        say(caution)
    say(f"Add it, its amplitude fitted: cbox add model.toml {path} --fit CAPTURE")


def effects(
    identifier: Annotated[
        str | None, typer.Argument(metavar="ID", help="One effect, in full.", autocompletion=complete_effect)
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write the effect's change of the bundled capture (PNG).")
    ] = None,
    new: Annotated[
        str | None,
        typer.Option(help="Write NAME.toml, an effect of what a diagnosis could not name.", metavar="NAME"),
    ] = None,
    diagnosis: Annotated[
        Path | None, typer.Option("--from", help="The diagnosis.json that explains it.", show_default=False)
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show the catalogue of physical effects that a model may lack, or write one from a diagnosis."""
    from cboxlab.rendering.effects import catalogue

    if new is not None or diagnosis is not None:
        if new is None or diagnosis is None or identifier is not None:
            raise InputError("cbox effects", "one of --new and --from", "cbox effects --new NAME --from diagnosis.json")
        _write_new(Path(f"{new.removesuffix('.toml')}.toml"), diagnosis, json)
        return
    if picture is not None and (identifier is None or picture.suffix.lower() != ".png"):
        raise InputError("--picture", f"{picture} of {identifier or 'no effect'}", "one effect and a file '.png'")

    known = catalogue()
    if identifier is None:
        give_json(json, {"effects": [effect.to_dict() for effect in known.values()]})
        _print_list(known)
        return
    if identifier not in known:
        expected = f"one of {', '.join(known)}"
        raise InputError("cbox effects", repr(identifier), expected, suggestion(identifier, known))
    effect = known[identifier]
    give_json(json, effect.to_dict())
    console.print(Text.assemble((effect.id, "bold"), f" (acts on: {effect.stage})"))
    say(f"{effect.summary}\n")
    table = Table("parameter", "unit", "null value", "from", "to", "choices")
    for p in effect.parameters:
        numbers = ("", "", "", "")
        if not p.choices:
            numbers = (p.unit, "–" if p.null is None else f"{p.null:g}", f"{p.low:g}", f"{p.high:g}")
        table.add_row(p.name, *numbers, ", ".join(p.choices))
    console.print(table)
    say(f"To confirm or rule out: {effect.confirm}")
    for source in effect.sources:
        say(f"Source: {source}")
    if picture is not None:
        from .effect_picture import pictured_light, write_effect_picture

        require_folder(picture.parent)
        with bar("rendering"):
            told = write_effect_picture(picture, effect, pictured_light())
        say(f"Signature: {picture} ({told})")
