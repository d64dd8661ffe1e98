"""``cbox capture``: a synthetic capture of a model."""

from __future__ import annotations

import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption, ModelArgument
from .console import (
    bar,
    give_json,
    options,
    positive_number,
    require_folder,
    say,
    warn_unless_compiled,
)

if TYPE_CHECKING:
    import numpy as np
    from cboxlab.rendering.effects import AppliedEffect
    from cboxlab.rendering.model import Model
    from cboxlab.rendering.synthetic import CaptureSettings
    from cboxlab.scenes.camera import Camera


__all__ = ["capture"]

#: Largest number of effects drawn until one can have the requested strength.
_DRAWS = 8


#: Chi-square per sample that a capture's render may add without a word.
_LARGEST_EXCESS = 0.05


def capture(
    model: ModelArgument,
    out: Annotated[Path, typer.Option(help="A new folder.", show_default=False)],
    *,
    size: Annotated[int, typer.Option(help="Pixels per side.", min=16, max=1024)] = 128,
    camera: Annotated[
        Path | None,
        typer.Option(help="In place of --size and a camera by chance: a camera file (.json), or a capture folder."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of camera and noise; default random.", min=0)] = None,
    noise: Annotated[str, typer.Option(help="Relative standard error of the render, median.")] = "0.1%",
    hide: Annotated[
        bool, typer.Option("--hide", help="Seal the effects: those of the model, or a random one.")
    ] = False,
    effects: Annotated[str | None, typer.Option(help="With --hide: draw one of these (id,id).")] = None,
    strength: Annotated[
        str | None, typer.Option(help="With --hide: faint, weak, medium or strong, by chi2 at this size.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Write a synthetic capture by the forward model, open or with a hidden effect and a sealed answer.

    With --hide the camera, exposures and survey of the laboratory vary too, and the blocks differ slightly from their
    surveyed positions. Some effects are not in the light but in the model, which stops too early: the capture's folder
    then contains that model.
    """
    import numpy as np
    from cboxlab.rendering.chain import PHOTOGRAPHED
    from cboxlab.rendering.model import load_model, view_of, write_model
    from cboxlab.rendering.synthetic import CaptureSettings
    from cboxlab.utils.files import replacing_folder

    from ...synthetic import perturbed_camera, seal, settled, varied_settings, write_model_capture

    error = positive_number(noise, "--noise")
    for option, value in (("--effects", effects), ("--strength", strength)):
        if value is not None and not hide:
            hint = "`cbox add` adds an effect to a model openly."
            raise InputError(option, "no --hide", f"{option} together with --hide", hint)
    require_folder(out.parent)
    chosen = load_model(model)
    number = secrets.randbits(63) if seed is None else seed
    generator = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    true_camera = perturbed_camera(size, number) if camera is None else view_of(camera)[0]
    settings = varied_settings(number) if hide else CaptureSettings()
    warn_unless_compiled()
    truncated = None
    if hide and (effects is not None or strength is not None or not chosen.effects):
        names = tuple(effects.split(",")) if effects else ()
        with options(effects="--effects", strength="--strength"):
            drawn = _drawn(chosen, names, strength, generator, true_camera, settings, number)
        if drawn.stage == "settings":
            bounces = int(generator.integers(1, 4))
            truncated = replace(chosen, render=replace(chosen.render, max_bounces=bounces), name="truncated")
        chosen = chosen.with_effect(drawn)
    with replacing_folder(out) as temporary:
        with bar("rendering") as report:
            inside = [effect for effect in chosen.effects if effect.stage in PHOTOGRAPHED]
            excess = write_model_capture(
                temporary,
                replace(chosen, effects=tuple(inside)),
                true_camera,
                settings,
                number,
                relative_error=error,
                progress=report,
                box=(lambda scene: settled(scene, number)) if hide else (lambda scene: scene),
            )
        if truncated is not None:
            write_model(temporary / "model.toml", truncated)
        digest = seal(temporary, chosen.effects, generator) if hide else ""
    if excess > _LARGEST_EXCESS:
        enough = error * np.sqrt(_LARGEST_EXCESS / excess)
        say(
            f"• The render's error is the same in every frame and adds up to {excess:.2g} to chi-square per sample, "
            f"which no model explains; --noise {enough:.2g} leaves {_LARGEST_EXCESS:g}."
        )
    secret = {"sha256": digest} if hide else {"seed": number}
    give_json(json, {"capture": out, "size_px": true_camera.width_px, "sealed": hide, **secret})
    if hide:
        say(f"Sealed. Keep this hash to detect any change of the answer: {digest}")
        say(f"Open the answer with: cbox reveal {out} --hash {digest}")
        if truncated is not None:
            say(f"Diagnose it with its own model: cbox diagnose {out} --model {out / 'model.toml'}")
    elif chosen.effects:
        say(f"Effects: {', '.join(effect.id for effect in chosen.effects)}")
    say(
        f"Capture: {out} ({true_camera.width_px} x {true_camera.height_px} px"
        + ("" if hide else f", seed {number}")
        + ")"
    )


def _drawn(
    model: Model,
    names: tuple[str, ...],
    strength: str | None,
    generator: np.random.Generator,
    camera: Camera,
    settings: CaptureSettings,
    seed: int,
) -> AppliedEffect:
    """A random effect of the requested strength. Raises InputError if the named effects cannot have it."""
    from ...synthetic import STRENGTHS, at_strength, draw_effect, photographed_scene, scale_of

    scene, bands = photographed_scene(model), tuple(settings.filters)
    if strength is None:
        return draw_effect(generator, scene, bands, names)
    if strength not in STRENGTHS:
        raise InputError("--strength", repr(strength), f"one of {', '.join(STRENGTHS)}")
    first = draw_effect(generator, scene, bands, names)
    with bar("computing strengths"):
        scale = scale_of(model, camera, settings, seed)
        for _ in range(_DRAWS):
            found = at_strength(first, STRENGTHS[strength], scale)
            if found is not None:
                return found
            first = draw_effect(generator, scene, bands, names)
    raise InputError("--strength", f"'{strength}', which {first.id} does not reach", "a weaker one, or another effect")
