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
_MAX_DRAWS = 8

#: Chi-square per sample by the error of the rendering from which a note is printed, in standard deviations of chance.
_LARGEST_EXCESS_SIGMA = 2.0


def capture(
    model: ModelArgument,
    out: Annotated[Path, typer.Option(help="New folder of the capture.", show_default=False)],
    *,
    size: Annotated[int, typer.Option(help="Pixels per side.", min=16, max=1024)] = 128,
    camera: Annotated[
        Path | None,
        typer.Option(help="Camera file (.json), or capture folder. It replaces --size and the random camera."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of camera and noise. The default is random.", min=0)] = None,
    noise: Annotated[str, typer.Option(help="Median relative standard error of the rendering.")] = "0.1%",
    mosaic: Annotated[
        str | None,
        typer.Option(
            help="Use a colour sensor with this mosaic behind one grey filter: RGGB, or rows separated by a space.",
            show_default=False,
        ),
    ] = None,
    hide: Annotated[
        bool, typer.Option("--hide", help="Hide the effects of the model, or a random effect, in a sealed answer.")
    ] = False,
    effects: Annotated[str | None, typer.Option(help="With --hide: effects to draw from, joined by commas.")] = None,
    strength: Annotated[
        str | None,
        typer.Option(help="With --hide: strength of the random effect by chi-square (faint, weak, medium or strong)."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Write a synthetic capture of a model, with open effects or with a hidden effect.

    With --hide, camera, exposures and survey vary too, and the blocks differ slightly from their surveyed positions.
    The answer is sealed in the capture, and `cbox reveal` opens it. If the hidden cause is a model with too few
    reflections, the folder contains this model.
    """
    import numpy as np
    from cboxlab.rendering.chain import PHOTOGRAPHED
    from cboxlab.rendering.model import load_model, view_of, write_model
    from cboxlab.rendering.synthetic import CaptureSettings, behind_mosaic
    from cboxlab.utils.files import replacing_folder

    from ...synthetic import perturbed_camera, seal, varied_settings, with_block_offsets, write_model_capture

    error = positive_number(noise, "--noise")
    for option, value in (("--effects", effects), ("--strength", strength)):
        if value is not None and not hide:
            hint = "`cbox add` adds an effect to a model openly."
            raise InputError(option, "no --hide", f"{option} together with --hide", hint)
    require_folder(out.parent)
    truth = load_model(model)
    number = secrets.randbits(63) if seed is None else seed
    generator = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    true_camera = perturbed_camera(size, number) if camera is None else view_of(camera)[0]
    settings = varied_settings(number) if hide else CaptureSettings()
    if mosaic is not None:
        with options(mosaic="--mosaic"):
            settings = behind_mosaic(settings, mosaic)
    warn_unless_compiled()
    truncated = None
    if hide and (effects is not None or strength is not None or not truth.effects):
        names = tuple(effects.split(",")) if effects else ()
        with options(effects="--effects", strength="--strength"):
            hidden = _random_effects(truth, names, strength, generator, true_camera, settings, number)
        truncated = _truncated(truth, generator) if hidden.stage == "settings" else None
        truth = truth.with_effect(hidden)
    with replacing_folder(out) as temporary:
        with bar("rendering") as report:
            inside = [effect for effect in truth.effects if effect.stage in PHOTOGRAPHED]
            excess = write_model_capture(
                temporary,
                replace(truth, effects=tuple(inside)),
                true_camera,
                settings,
                number,
                relative_error=error,
                progress=report,
                box=(lambda scene: with_block_offsets(scene, number)) if hide else (lambda scene: scene),
            )
        if truncated is not None:
            write_model(temporary / "model.toml", truncated)
        digest = seal(temporary, truth.effects, generator) if hide else ""
    secret = {"sha256": digest} if hide else {"seed": number}
    give_json(json, {"capture": out, "size_px": true_camera.width_px, "sealed": hide, **secret})
    number_printed = "" if hide else f", seed {number}"
    say(f"Capture: {out} ({true_camera.width_px} x {true_camera.height_px} px{number_printed})")
    if hide:
        _say_sealed(out, digest, truncated is not None)
    elif truth.effects:
        say(f"Effects: {', '.join(effect.id for effect in truth.effects)}")
    _note_error_of_rendering(excess, error, len(settings.filters) * true_camera.width_px * true_camera.height_px)


def _truncated(model: Model, generator: np.random.Generator) -> Model:
    """The model with one to three reflections, to which the hidden effect adds the others."""
    render = replace(model.render, max_bounces=int(generator.integers(1, 4)))
    return replace(model, render=render, name="truncated")


def _say_sealed(out: Path, digest: str, has_model: bool) -> None:
    """Print the hash of a sealed answer and the commands that follow."""
    say(f"The seal has hash {digest}. Keep it: it proves that the answer is unchanged.")
    say(f"To open the answer: cbox reveal {out} --hash {digest}")
    if has_model:
        say(f"To diagnose the capture with its model: cbox diagnose {out} --model {out / 'model.toml'}")


def _note_error_of_rendering(excess: float, error: float, samples: int) -> None:
    """Note a rendering whose error adds more to chi-square than noise may.

    excess : of chi-square per sample. error : relative standard error of the rendering.
    """
    visible = _LARGEST_EXCESS_SIGMA * (2 / samples) ** 0.5
    if excess > visible:
        enough = error * (visible / excess) ** 0.5
        say(
            f"• The error of the rendering is the same in every frame. It adds up to {excess:.2g} to chi-square per "
            f"sample, which no model explains. With --noise {enough:.2g} it adds {visible:.2g}, as much as noise may."
        )


def _random_effects(
    model: Model,
    names: tuple[str, ...],
    strength: str | None,
    generator: np.random.Generator,
    camera: Camera,
    settings: CaptureSettings,
    seed: int,
) -> AppliedEffect:
    """Random effect of the requested strength; InputError if the named effects cannot have it."""
    from ...synthetic import STRENGTHS, at_strength, draw_effect, photographed_scene, scale_of

    scene, bands = photographed_scene(model), settings.band_ids
    if strength is None:
        return draw_effect(generator, scene, bands, names)
    if strength not in STRENGTHS:
        raise InputError("--strength", repr(strength), f"one of {', '.join(STRENGTHS)}")
    first = draw_effect(generator, scene, bands, names)
    with bar("computing strengths"):
        scale = scale_of(model, camera, settings, seed)
        for _ in range(_MAX_DRAWS):
            scaled = at_strength(first, STRENGTHS[strength], scale)
            if scaled is not None:
                return scaled
            first = draw_effect(generator, scene, bands, names)
    raise InputError(
        "--strength", f"'{strength}', which {first.id} does not reach", "a weaker strength, or another effect"
    )
