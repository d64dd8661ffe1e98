"""Commands on models: add an effect, show the catalogue."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import suggestion
from rich.table import Table

from .console import bar, console, require_folder, say

if TYPE_CHECKING:
    from .effects import AppliedEffect
    from .model import Model

__all__ = ["add", "effects"]


def add(
    model: Annotated[
        Path, typer.Argument(help="Model file (TOML); made where it is missing.", show_default=False)
    ],
    effect: Annotated[str, typer.Argument(help="Identifier, see `cbox effects`.", show_default=False)],
    values: Annotated[list[str] | None, typer.Argument(help="key=value ...", show_default=False)] = None,
    fit: Annotated[
        Path | None, typer.Option(help="Fit what is left out to this capture, camera and lamp with it.")
    ] = None,
) -> None:
    """A model with one more effect; parameters left out take their default or null value, or are fitted."""
    from cboxlab.scenes.scene_file import load_scene

    from .effects import apply_checked, names_in
    from .model import Model, load_model, write_model

    if model.suffix != ".toml":
        raise InputError(model, f"the ending '{model.suffix}'", "a model file, '.toml'")
    given = dict(_pair(text) for text in values or ())
    current = load_model(model) if model.exists() else Model(name=model.stem)
    applied = apply_checked(effect, given, "cbox add", names_in(load_scene(current.scene)))
    if fit is not None:
        require_folder(model.parent)
        applied = _fitted(fit, current, effect, given)
    if current.scene.endswith(".toml"):
        current = replace(current, scene=Path(os.path.relpath(current.scene, model.parent)).as_posix())
    grown = current.with_effect(applied)
    write_model(model, grown)
    shown = ", ".join(
        f"{key} = {value if isinstance(value, str) else format(value, '.5g')}"
        + (f" ± {applied.sigma[key]:.2g}" if key in applied.sigma else "")
        for key, value in applied.values.items()
    )
    say(f"{model}: added {effect} ({shown}); effects now: {', '.join(e.id for e in grown.effects)}")


def _fitted(capture: Path, model: Model, effect: str, given: dict[str, str | float]) -> AppliedEffect:
    from .effect_fit import fit_effect
    from .picture_cache import default_cache

    with bar(f"fitting {effect}") as report:
        applied, before, after = fit_effect(capture, model, effect, given, report, default_cache())
    say(f"χ² per sample {before:.4g} without it, {after:.4g} with it, camera and lamp at their best")
    return applied


def _pair(text: str) -> tuple[str, str | float]:
    key, separator, value = text.partition("=")
    if not separator or not key or not value:
        raise InputError("cbox add", repr(text), "key=value, such as fraction=0.02")
    try:
        return key, float(value)
    except ValueError:
        return key, value


def effects(
    identifier: Annotated[str | None, typer.Argument(help="One effect, in full.")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write what the effect changes in the bundled capture (PNG).")
    ] = None,
) -> None:
    """The catalogue of physical effects a model may lack."""
    from .effects import catalogue

    if picture is not None and (identifier is None or picture.suffix.lower() != ".png"):
        raise InputError(
            "--picture", f"{picture} of {identifier or 'no effect'}", "one effect and a file '.png'"
        )

    known = catalogue()
    if identifier is None:
        table = Table("effect", "acts on", "parameters", "what happens")
        for effect in known.values():
            table.add_row(
                effect.id, effect.stage, ", ".join(p.name for p in effect.parameters), effect.summary
            )
        console.print(table)
        return
    if identifier not in known:
        expected = f"one of {', '.join(known)}"
        raise InputError("cbox effects", repr(identifier), expected, suggestion(identifier, known))
    effect = known[identifier]
    console.print(f"[bold]{effect.id}[/] (acts on: {effect.stage})")
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
        from .effect_picture import write_effect_picture

        require_folder(picture.parent)
        with bar("rendering"):
            told = write_effect_picture(picture, effect)
        say(f"Signature: {picture} ({told})")
