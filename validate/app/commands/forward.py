"""Commands that simulate a model: render, capture, reveal."""

from __future__ import annotations

import math
import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .console import (
    JsonOption,
    bar,
    choose_device,
    data_table,
    errors,
    give_json,
    options,
    positive_number,
    print_table,
    require_folder,
    say,
    this_run,
    warn_unless_compiled,
    wavelengths,
)

if TYPE_CHECKING:
    import numpy as np
    from cboxlab.rendering.effects import AppliedEffect
    from cboxlab.rendering.model import Model
    from cboxlab.rendering.photometry import Photometry
    from cboxlab.rendering.synthetic import CaptureSettings
    from cboxlab.scenes.camera import Camera

    from ...synthetic import Answer, Score

__all__ = ["capture", "render", "reveal"]

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="Model or scene file (TOML), or a packaged scene: cornell-box.",
        show_default=False,
    ),
]

#: Largest number of effects drawn until one can have the requested strength.
_DRAWS = 8

#: Chi-square per sample that a capture's render may add without a word.
_LARGEST_EXCESS = 0.05

#: Largest number of pixels per side.
LARGEST_SIZE = 8192


def render(
    model: ModelArgument,
    out: Annotated[
        Path,
        typer.Option(help="The cube: .nc (with standard errors), .exr, .hdr (ENVI) or .png.", show_default=False),
    ],
    *,
    at: Annotated[str, typer.Option("--wavelengths", help="first:last:step in nm, or a list a,b,c.")] = "400:700:10",
    size: Annotated[
        int, typer.Option(help="Pixels per side, for the published camera.", min=2, max=LARGEST_SIZE)
    ] = 256,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="In place of --size: a camera file (.json), or a capture folder with its calibrated camera and lamp."
        ),
    ] = None,
    noise: Annotated[
        str, typer.Option(help="Relative standard error per pixel and wavelength, at which rendering stops.")
    ] = "0.3%",
    percentile: Annotated[
        float, typer.Option(help="Percentile of the pixels' errors to which --noise applies.", min=1, max=100)
    ] = 50.0,
    samples: Annotated[int | None, typer.Option(help="Samples per pixel and batch, instead of --noise.", min=1)] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the random numbers; default that of the model.", min=0)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers share the passes.")
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="cpu or cuda; default the environment variable CBOX_DEVICE, else cpu.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Render a spectral cube of a model: the light before filters and sensor.

    If interrupted, the same command resumes after the last finished pass (kept beside the cube as CUBE.passes),
    or, where it is large, strip (CUBE.strips).
    """
    choose_device(device)
    from cboxlab.rendering.files import WRITABLE, files_of
    from cboxlab.rendering.model import load_model
    from cboxlab.scenes.cornell_box import cornell_camera

    from ...api import CubeSettings, render_file, write_manifest

    if out.suffix.lower() not in WRITABLE:
        raise InputError(out, f"the ending '{out.suffix}'", f"one of {', '.join(WRITABLE)}")
    grid, error = wavelengths(at), positive_number(noise, "--noise")
    require_folder(out.parent)
    chosen = load_model(model)
    warn_unless_compiled()
    settings = CubeSettings(grid, error, percentile, samples, seed, scheduler, this_run.command)
    with options(scheduler="--scheduler"), bar("rendering") as report:
        made = render_file(out, chosen, camera or cornell_camera(size), settings, report)
        inputs = [*chosen.files, Path(model), *([] if camera is None else [camera])]
        write_manifest(out, files_of(out), inputs, seed=chosen.render.seed if seed is None else seed)
    light = None if made.photometry is None else made.photometry.to_dict()
    if made.photometry is not None:
        _print_photometry(made.photometry)
    for note in made.notes:
        say(f"• {note}")
    found = {
        "cube": out,
        "width_px": made.width_px,
        "height_px": made.height_px,
        "wavelength_nm": grid.tolist(),
    }
    give_json(json, {**found, "notes": made.notes, "photometry": light})
    say(f"Cube: {out} ({made.width_px} x {made.height_px} px, {grid.size} wavelengths)")


def _print_photometry(light: Photometry) -> None:
    table = data_table(
        f"Luminance {light.range_text} (CIE 1931), on whole pixels",
        "surface",
        "cd/m²",
        "x",
        "y",
        "± x, y",
        "px",
        "lx",
    )
    rows = [(name, part, light.illuminance(name)) for name, part in light.surfaces.items()]
    for name, part, lx in [*rows, ("lamp", light.lamp, math.nan), ("whole picture", light.picture, math.nan)]:
        sigma = float(part.chromaticity_sigma.max())
        table.add_row(
            name,
            _with_error(part.luminance, part.luminance_sigma),
            *(_shown(v, ".4f") for v in part.chromaticity),
            _shown(sigma, ".5f"),
            str(part.pixels),
            _shown(lx, ".4g"),
        )
    print_table(table)


def _with_error(value: float, sigma: float) -> str:
    """A value and its error, which has two digits; a dash for NaN."""
    if not (math.isfinite(sigma) and sigma > 0):
        return _shown(value, ".5g")
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _shown(value: float, form: str) -> str:
    """The formatted value, without an exponent where it is large; a dash for NaN."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:{form}}"
    return f"{float(text):.0f}" if "e+" in text else text


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


def reveal(
    folder: Annotated[Path, typer.Argument(help="A capture made with --hide.", show_default=False)],
    diagnosis: Annotated[Path | None, typer.Option(help="File of `cbox diagnose --json`, to be scored.")] = None,
    expected_hash: Annotated[
        str | None,
        typer.Option(
            "--hash",
            help="The hash told when the capture was sealed; another one ends with exit code 1.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Open a sealed answer, and score a diagnosis against it.

    Exit code 1, and nothing is opened, where the seal has another hash than --hash.
    """
    from ...synthetic import open_seal, read_diagnosis, score

    with options("`cbox diagnose --json` writes one."):
        found = None if diagnosis is None else read_diagnosis(diagnosis)
    with options("`cbox capture --hide` makes one."):
        answer = open_seal(folder)
    if expected_hash is not None and expected_hash.strip().lower() != answer.sha256:
        errors.print(
            f"{folder}: the seal has the hash {answer.sha256}, not {expected_hash}: another answer was sealed since",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(1)
    say(f"The seal's hash: {answer.sha256}")
    if expected_hash is None:
        say(
            "Capture and answer are those of this seal. Whether it is the first one is not checked: give --hash, "
            "the hash told when the capture was sealed."
        )
    else:
        say("It is the one told: capture and answer are unchanged since then.")
    if not answer.effects:
        say("No effect was hidden.")
    result = None if found is None else score(answer, found)
    _print_answer(answer, result)
    hidden = [{"effect": name, "parameters": dict(values)} for name, values in answer.effects]
    checked = expected_hash is not None
    give_json(
        json,
        {
            "sha256": answer.sha256,
            "hash_checked": checked,
            "hidden": hidden,
            "score": None if result is None else result.to_dict(),
        },
    )


def _print_answer(answer: Answer, result: Score | None) -> None:
    table = data_table(
        "Hidden", "effect", "parameters", *(() if result is None else ("rank", "selected", "error of each"))
    )
    for index, (name, parameters) in enumerate(answer.effects):
        cells = [
            name,
            ", ".join(f"{k} = {v if isinstance(v, str) else format(v, '.4g')}" for k, v in parameters.items()),
        ]
        if result is not None:
            row = result.effects[index]
            errors = ", ".join(f"{key} {100 * error:+.1f}%" for key, error in row.errors.items())
            cells += [str(row.rank or "–"), "yes" if row.selected else "no", errors or "–"]
        table.add_row(*cells)
    if answer.effects:
        print_table(table)
    if result is not None:
        first, selection = ("right" if sound else "wrong" for sound in (result.first, result.exact))
        say(f"First of the ranking: {first}. Selection: {selection}.")
        if result.falsely_selected:
            say(f"Selected, but not hidden: {', '.join(result.falsely_selected)}")
