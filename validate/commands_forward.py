"""Commands that go forwards from a model: render, capture, reveal."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.scenes.errors import InputError

from .console import (
    bar,
    choose_device,
    console,
    data_table,
    positive_number,
    require_compiled,
    require_folder,
    say,
    wavelengths,
)

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from cboxlab.render.laboratory import CaptureSettings
    from cboxlab.scenes.camera import Camera
    from cboxlab.scenes.spectra import Spectrum

    from .blind import Answer, Score
    from .effects import AppliedEffect
    from .model import Model

__all__ = ["capture", "render", "reveal"]

Progress = Callable[[float], None]

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL", help="Model file (TOML), or a packaged scene: cornell-box.", show_default=False
    ),
]

#: Effects drawn until one can be made as strong as asked for.
_DRAWS = 8

#: Pixels a side beyond which nothing is computed.
LARGEST_SIZE = 8192
#: Bytes of all passes of a cube from which on it is rendered and written by strips of rows.
LARGEST_IN_MEMORY = 2**32


def _model(name: str) -> Model:
    from cboxlab.scenes.scene_file import packaged_scenes

    from .model import Model, load_model

    return Model(scene=name, name=name) if name in packaged_scenes() else load_model(Path(name))


def render(
    model: ModelArgument,
    out: Annotated[
        Path,
        typer.Option(
            help="The cube: .nc (with standard errors), .exr, .hdr (ENVI) or .png.", show_default=False
        ),
    ],
    at: Annotated[
        str, typer.Option("--wavelengths", help="first:last:step in nm, or a list a,b,c.")
    ] = "400:700:10",
    size: Annotated[
        int, typer.Option(help="Pixels a side, of the published camera.", min=2, max=LARGEST_SIZE)
    ] = 256,
    camera: Annotated[
        Path | None,
        typer.Option(help="A capture folder: its calibrated camera, in place of --size, and its lamp."),
    ] = None,
    noise: Annotated[
        str, typer.Option(help="Relative standard error of a pixel and wavelength to render down to.")
    ] = "0.3%",
    percentile: Annotated[
        float, typer.Option(help="Of the pixels' errors, which --noise is about: the median.", min=1, max=100)
    ] = 50.0,
    samples: Annotated[
        int | None, typer.Option(help="Samples per pixel and batch, in place of --noise.", min=1)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the random numbers; the model's where left out.", min=0)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers share the passes.")
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="cpu or cuda; the environment's CBOX_DEVICE where left out.")
    ] = None,
) -> None:
    """A spectral cube of a model: everything before filters and sensor.

    Interrupted, it goes on from its last finished pass (kept beside the cube as CUBE.passes) when started again.
    """
    choose_device(device)
    from cboxlab.render.cube_files import WRITABLE, write_cube
    from cboxlab.render.integrators import render as run
    from cboxlab.render.precision import BATCHES, fireflies, relative_error, render_to_precision
    from cboxlab.scenes.cornell_box import cornell_camera

    from .forward import labelled_cube, model_cube_inputs

    if out.suffix.lower() not in WRITABLE:
        raise InputError(out, f"the ending '{out.suffix}'", f"one of {', '.join(WRITABLE)}")
    grid, error = wavelengths(at), positive_number(noise, "--noise")
    require_folder(out.parent)
    chosen = _model(model)
    view, lamp = (cornell_camera(size), None) if camera is None else _camera_and_lamp(camera)
    scene, view, bounces = model_cube_inputs(chosen, view, lamp)
    number = chosen.render.seed if seed is None else seed
    require_compiled()
    kept = out.with_name(f"{out.name}.passes")

    notes = []

    def picture(part: Camera, index: int, report: Progress, checkpoint: Path | None) -> xr.Dataset:
        own_seed = number + 104729 * index
        if samples is None:
            image = render_to_precision(
                scene, part, grid, error, bounces, own_seed, report, percentile, checkpoint, scheduler
            )
        else:
            image = run(scene, part, grid, samples, BATCHES, own_seed, bounces, report)
        median, most = (relative_error(image, p) for p in (50.0, 99.0))
        where = "" if part is view else f"strip {index + 1}: "
        notes.append(f"{where}standard error {median:.2%} (median), {most:.2%} (99 of 100 pixels)")
        if count := int(fireflies(image).sum()):
            notes.append(
                f"{where}{count} pixels owe much to a single pass (fireflies); their error is understated"
            )
        return labelled_cube(image)

    with bar("rendering") as report:
        if BATCHES * 4 * view.width_px * view.height_px * grid.size > LARGEST_IN_MEMORY:
            write_in_strips(out, view, picture, report)
        else:
            write_cube(out, picture(view, 0, report, kept))
            kept.unlink(missing_ok=True)
    for note in notes:
        say(f"• {note}")
    behind = [e.id for e in chosen.effects if e.effect.stage in ("filter", "optics", "counts")]
    if behind:
        say(f"• Not in a cube, since they act behind the scene: {', '.join(behind)}")
    say(f"Cube: {out} ({view.width_px} x {view.height_px} px, {grid.size} wavelengths)")


def write_in_strips(
    out: Path, view: Camera, picture: Callable[[Camera, int, Progress, None], xr.Dataset], report: Progress
) -> None:
    """A cube larger than memory: ``picture`` of one strip after another, as NetCDF."""
    from cboxlab.render.cube_strips import strip_cameras, write_strips

    parts = strip_cameras(view)

    def reported(index: int) -> Progress:
        return lambda done: report((index + done) / len(parts))

    strips = (picture(part, index, reported(index), None) for index, part in enumerate(parts))
    write_strips(out, view.height_px, strips)


def _camera_and_lamp(folder: Path) -> tuple[Camera, Spectrum | None]:
    """As calibrated; the lamp as measured, None where the capture does not state it."""
    from cboxlab.calibration.camera_calibration import calibrate_camera
    from cboxlab.calibration.capture import load_capture

    loaded = load_capture(folder)
    fit, target, _ = calibrate_camera(loaded)
    stated = loaded.manifest.lamp
    lamp = None if stated is None else loaded.light(stated.radiance)
    if target is not None and target.survey_camera is not None:
        return target.survey_camera, lamp
    if fit is None:
        raise InputError(
            folder / "capture.toml", "no [geometry] with points", "surveyed points, for the camera"
        )
    return fit.camera, lamp


def capture(
    model: ModelArgument,
    out: Annotated[Path, typer.Option(help="A new folder.", show_default=False)],
    size: Annotated[int, typer.Option(help="Pixels a side.", min=16, max=1024)] = 128,
    seed: Annotated[
        int | None, typer.Option(help="Of camera and noise; by chance where left out.", min=0)
    ] = None,
    noise: Annotated[str, typer.Option(help="Relative standard error of the render in it, median.")] = "0.1%",
    hide: Annotated[
        bool, typer.Option("--hide", help="Seal what is in it: the model's effects, or one by chance.")
    ] = False,
    effects: Annotated[str | None, typer.Option(help="With --hide: draw one of these (id,id).")] = None,
    strength: Annotated[
        str | None, typer.Option(help="With --hide: weak, medium or strong, by chi2 at this size.")
    ] = None,
) -> None:
    """A synthetic capture by the forward model, openly or with a hidden effect and a sealed answer.

    With --hide the laboratory's camera, exposures and survey vary too, and the blocks stand a little beside their
    surveyed places. For the hidden effect interreflection a model that stops too early lies in the capture's folder.
    """
    import numpy as np
    from cboxlab.render.laboratory import CaptureSettings
    from cboxlab.scenes.files import replacing_folder

    from .blind import seal
    from .model import write_model
    from .synthetic import perturbed_camera, write_model_capture
    from .varied import settled, varied_settings

    error = positive_number(noise, "--noise")
    for option, value in (("--effects", effects), ("--strength", strength)):
        if value is not None and not hide:
            hint = "`cbox add` puts effects into a model openly."
            raise InputError(option, "no --hide", "--hide with it", hint)
    require_folder(out.parent)
    chosen = _model(model)
    number = secrets.randbits(63) if seed is None else seed
    generator = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    camera = perturbed_camera(size, number)
    settings = varied_settings(number) if hide else CaptureSettings()
    require_compiled()
    truncated = None
    if hide and (effects is not None or strength is not None or not chosen.effects):
        names = tuple(effects.split(",")) if effects else ()
        drawn = _drawn(chosen, names, strength, generator, camera, settings, number)
        if drawn.effect.stage == "settings":
            bounces = int(generator.integers(1, 4))
            truncated = replace(chosen, render=replace(chosen.render, max_bounces=bounces), name="truncated")
        chosen = chosen.with_effect(drawn)
    with replacing_folder(out) as temporary:
        with bar("rendering") as report:
            inside = [effect for effect in chosen.effects if effect.effect.stage != "settings"]
            write_model_capture(
                temporary, replace(chosen, effects=tuple(inside)), camera, settings, number, error, report,
                (lambda scene: settled(scene, number)) if hide else (lambda scene: scene),
            )  # fmt: skip
        if truncated is not None:
            write_model(temporary / "model.toml", truncated)
        digest = seal(temporary, chosen.effects, generator) if hide else ""
    if hide:
        say(f"Sealed. Keep this hash, so that no answer can change unnoticed: {digest}")
        say(f"Open it with: cbox reveal {out}")
        if truncated is not None:
            say(f"Its model is not the published box: cbox diagnose {out} --model {out / 'model.toml'}")
    elif chosen.effects:
        say(f"Effects in it: {', '.join(effect.id for effect in chosen.effects)}")
    say(f"Capture: {out} ({size} x {size} px" + ("" if hide else f", seed {number}") + ")")


def _drawn(
    model: Model, names: tuple[str, ...], strength: str | None, generator: np.random.Generator, camera: Camera,
    settings: CaptureSettings, seed: int,
) -> AppliedEffect:  # fmt: skip
    """An effect by chance, as strong as asked for. Raises InputError where none of those named can be."""
    from .blind import draw_effect
    from .strengths import STRENGTHS, at_strength, scale_of

    if strength is None:
        return draw_effect(generator, names)
    if strength not in STRENGTHS:
        raise InputError("--strength", repr(strength), f"one of {', '.join(STRENGTHS)}")
    first = draw_effect(generator, names)
    with bar("weighing effects"):
        scale = scale_of(model, camera, settings, seed)
        for _ in range(_DRAWS):
            found = at_strength(first, STRENGTHS[strength], scale)
            if found is not None:
                return found
            first = draw_effect(generator, names)
    raise InputError(
        "--strength", f"'{strength}', which {first.id} does not reach", "less, or another effect"
    )


def reveal(
    folder: Annotated[Path, typer.Argument(help="A capture made with --hide.", show_default=False)],
    diagnosis: Annotated[Path | None, typer.Option(help="What `cbox diagnose --json` wrote: scored.")] = None,
) -> None:
    """Open a sealed answer, and score a diagnosis against it."""
    from .blind import open_seal, read_diagnosis, score

    found = None if diagnosis is None else read_diagnosis(diagnosis)
    answer = open_seal(folder)
    say("The seal is whole." if answer.effects else "The seal is whole; nothing was hidden.")
    _print_answer(answer, None if found is None else score(answer, found))


def _print_answer(answer: Answer, result: Score | None) -> None:
    table = data_table(
        "Hidden", "effect", "parameters", *(() if result is None else ("rank", "selected", "error of each"))
    )
    for index, (name, parameters) in enumerate(answer.effects):
        cells = [
            name,
            ", ".join(
                f"{k} = {v if isinstance(v, str) else format(v, '.4g')}" for k, v in parameters.items()
            ),
        ]
        if result is not None:
            row = result.effects[index]
            errors = ", ".join(f"{key} {100 * error:+.1f}%" for key, error in row.errors.items())
            cells += [str(row.rank or "–"), "yes" if row.selected else "no", errors or "–"]
        table.add_row(*cells)
    if answer.effects:
        console.print(table)
    if result is not None:
        first, selection = ("right" if sound else "wrong" for sound in (result.first, result.exact))
        say(f"First answer: {first}. Selection: {selection}.")
        if result.falsely_selected:
            say(f"Selected, but not there: {', '.join(result.falsely_selected)}")
