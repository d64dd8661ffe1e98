"""``cbox add``: add an effect to a model."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import folder_lock
from cboxlab.utils.numbers import number_of
from cboxlab.utils.progress import share

from .arguments import JsonOption, complete_effect
from .console import bar, give_json, options, require_file, say

if TYPE_CHECKING:
    from cboxlab.rendering.effects import AppliedEffect, Effect
    from cboxlab.rendering.model import Model

__all__ = ["add"]


def add(
    model: Annotated[
        Path, typer.Argument(help="Model file (TOML). It is created if it does not exist.", show_default=False)
    ],
    effect: Annotated[
        str,
        typer.Argument(
            help="Identifier of an effect (see `cbox effects`), or an effect file (.toml).",
            show_default=False,
            autocompletion=complete_effect,
        ),
    ],
    values: Annotated[list[str] | None, typer.Argument(help="Parameters, as key=value ...", show_default=False)] = None,
    fit: Annotated[
        Path | None,
        typer.Option(help="Fit the omitted parameters to this capture, with camera and lamp."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            help="Scene file or packaged scene of a new model. The default is cornell-box, or with --fit the capture's "
            "scene."
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Add an effect to a model.

    A parameter that you omit gets its default, or else the value at which the effect does nothing. With --fit it is
    fitted.
    """
    from cboxlab.calibration.capture import load_capture
    from cboxlab.rendering.effects import apply_checked, names_in
    from cboxlab.rendering.model import Model, load_model, named_effect, write_model
    from cboxlab.scenes import load_scene

    from ...api import as_model

    if model.suffix != ".toml":
        raise InputError(model, f"the ending '{model.suffix}'", "a model file, '.toml'")
    pairs = dict(_pair(text) for text in values or ())
    before = _content(model)
    if scene is not None and model.exists():
        raise InputError("--scene", f"'{scene}', and {model} exists", "no --scene: the model has a scene")
    current = load_model(model) if model.exists() else Model(name=model.stem)
    if current.scene.origin is not None and current.scene.origin.reference == str(model.resolve()):
        raise InputError(model, "a scene file", "a model file", f"Name a new model, with --scene {model}.")
    if scene is None and fit is not None and not model.exists():
        current = replace(current, scene=as_model(None, [load_capture(fit)]).scene)
    if scene is not None:
        current = replace(current, scene=load_scene(scene))
    definition = named_effect(effect, Path())
    applied = apply_checked(definition, pairs, effect, names_in(current.scene))
    before_after: dict[str, float] = {}
    if fit is not None:
        require_file(model)
        applied, before_after = _fitted(fit, current, applied.effect, pairs)
    grown = current.with_effect(applied)
    model.parent.mkdir(parents=True, exist_ok=True)
    with folder_lock(model.parent):
        if _content(model) != before:
            raise InputError(
                model,
                "content that changed since the command began",
                "a model that no other program changes",
                "Run the command again.",
            )
        write_model(model, grown)
    parameters = ", ".join(
        f"{key} = {value if isinstance(value, str) else format(value, '.5g')}"
        + (f" ± {applied.sigma[key]:.2g}" if key in applied.sigma else "")
        for key, value in applied.values.items()
    )
    added = {"effect": applied.id, "parameters": dict(applied.values), "sigma": dict(applied.sigma)}
    give_json(json, {"model": model, "added": added, "effects": [e.id for e in grown.effects], **before_after})
    say(f"{model}: added {applied.id} ({parameters}). Its effects: {', '.join(e.id for e in grown.effects)}.")


def _content(path: Path) -> bytes | None:
    """Content of a file; None if it does not exist."""
    return path.read_bytes() if path.exists() else None


def _fitted(
    capture: Path, model: Model, effect: Effect, values: dict[str, str | float]
) -> tuple[AppliedEffect, dict[str, float]]:
    """Fitted effect, and chi-square per sample before and after as keys of the record."""
    from ...api import Study
    from ...diagnose import fit_effect
    from ...predict import default_cache

    with options(fit="--fit"), bar(f"fitting {effect.id}") as report:
        study = Study.open(capture, model=model, cache=default_cache(), progress=share(report, 0.0, 0.8))
        applied, before, after = fit_effect(study.validations()[0], effect, values, share(report, 0.8, 1.0))
    say(f"χ² per sample, with camera and lamp fitted: {before:.4g} without the effect, {after:.4g} with it.")
    return applied, {"chi2_per_sample_before": before, "chi2_per_sample": after}


def _pair(text: str) -> tuple[str, str | float]:
    """Key and value of an argument key=value."""
    key, separator, value = text.partition("=")
    if not separator or not key or not value:
        raise InputError("cbox add", repr(text), "key=value, such as fraction=0.02")
    number = number_of(value)
    return (key, value) if math.isnan(number) else (key, number)
