"""``cbox effects``: the catalogue of effects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError
from cboxlab.utils.table import Table
from rich.text import Text

from .arguments import JsonOption, complete_effect
from .console import bar, console, give_json, options, print_result, require_file, require_folder, say

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cboxlab.rendering.effects import Effect

__all__ = ["effects"]


def effects(
    identifier: Annotated[
        str | None, typer.Argument(metavar="ID", help="Effect to describe in full.", autocompletion=complete_effect)
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write a picture (PNG) of the effect's change of the bundled capture.")
    ] = None,
    new: Annotated[
        str | None,
        typer.Option(
            help="Write NAME.toml, a new effect for the cause that a diagnosis could not name.", metavar="NAME"
        ),
    ] = None,
    diagnosis: Annotated[
        Path | None,
        typer.Option("--from", help="With --new: the diagnosis.json that describes the cause.", show_default=False),
    ] = None,
    json: JsonOption = None,
) -> None:
    """List the physical effects that a model may lack, describe one, or write a new one."""
    from cboxlab.rendering.effects import catalogue

    if new is not None or diagnosis is not None:
        if new is None or diagnosis is None or identifier is not None:
            raise InputError("cbox effects", "one of --new and --from", "cbox effects --new NAME --from diagnosis.json")
        _write_new(Path(f"{new.removesuffix('.toml')}.toml"), diagnosis, json)
        return
    if picture is not None and (identifier is None or picture.suffix.lower() != ".png"):
        raise InputError("--picture", f"{picture} of {identifier or 'no effect'}", "one effect and a file '.png'")

    by_name = catalogue()
    if identifier is None:
        give_json(json, {"effects": [effect.to_dict() for effect in by_name.values()]})
        _print_list(by_name)
        return
    if identifier not in by_name:
        from cboxlab.utils.faults import suggestion

        expected = f"one of {', '.join(by_name)}"
        raise InputError("cbox effects", repr(identifier), expected, suggestion(identifier, by_name))
    effect = by_name[identifier]
    give_json(json, effect.to_dict())
    console.print(Text.assemble((effect.id, "bold"), f" (acts on: {effect.stage})"))
    say(f"{effect.summary}\n")
    print_result([], [_parameter_table(effect)])
    say(f"To confirm it or rule it out: {effect.confirm}")
    for source in effect.sources:
        say(f"Source: {source}")
    if picture is not None:
        from .effect_picture import pictured_light, write_effect_picture

        require_file(picture)
        with bar("rendering"):
            values = write_effect_picture(picture, effect, pictured_light())
        say(f"Signature with {values}: {picture}")


def _parameter_table(effect: Effect) -> Table:
    """Units, null values and bounds of an effect's parameters; a dash if there is no null value."""
    rows = []
    for p in effect.parameters:
        numbers = ("", "", "", "")
        if not p.choices:
            numbers = (p.unit, "–" if p.null is None else f"{p.null:g}", f"{p.low:g}", f"{p.high:g}")
        rows.append((p.name, *numbers, ", ".join(p.choices)))
    columns = ("parameter", "unit", "null value", "from", "to", "choices")
    return Table("Parameters", columns, tuple(rows), text_columns=(0, 5))


def _print_list(by_name: Mapping[str, Effect]) -> None:
    """Print one line for each effect, by the stage at which it acts, in the order of light."""
    from cboxlab.rendering.chain import STAGES

    width = max(len(name) for name in by_name)
    say("Stage, effect, and how the real box or its photograph differs from the model:")
    for stage in STAGES:
        for index, effect in enumerate(e for e in by_name.values() if e.stage == stage):
            say(f"{stage if index == 0 else '':<{max(map(len, STAGES))}} {effect.id:<{width}} {effect.short_title}")
    say("To describe one effect with its parameters: cbox effects ID")


def _write_new(path: Path, diagnosis: Path, json: Path | None) -> None:
    """Write an effect from a diagnosis."""
    from cboxlab.rendering.fitted_fields import effect_of_diagnosis

    require_folder(path.parent)
    with options(**{"name of the effect": "--new"}):
        effect, caution = effect_of_diagnosis(path, diagnosis)
    give_json(json, {"file": path, "caution": caution, **effect.to_dict()})
    say(f"{path}: {effect.short_title}")
    if caution:
        say(caution)
    say(f"To add it with a fitted amplitude: cbox add model.toml {path} --fit CAPTURE")
