"""Commands that go forwards from a model: render, simulate, capture, reveal."""

from __future__ import annotations

import secrets
from collections.abc import Callable
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
    import xarray as xr
    from cboxlab.scenes.camera import Camera

    from .blind import Answer, Score
    from .model import Model

__all__ = ["capture", "render", "reveal", "simulate"]

Progress = Callable[[float], None]

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL", help="Model file (TOML), or a packaged scene: cornell-box.", show_default=False
    ),
]

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
        Path | None, typer.Option(help="A capture folder: its calibrated camera, in place of --size.")
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
    from cboxlab.render.precision import BATCHES, render_to_precision
    from cboxlab.scenes.cornell_box import cornell_camera

    from .forward import labelled_cube, model_cube_inputs

    if out.suffix.lower() not in WRITABLE:
        raise InputError(out, f"the ending '{out.suffix}'", f"one of {', '.join(WRITABLE)}")
    grid, error = wavelengths(at), positive_number(noise, "--noise")
    require_folder(out.parent)
    chosen = _model(model)
    view = cornell_camera(size) if camera is None else _calibrated_camera(camera)
    scene, view, bounces = model_cube_inputs(chosen, view)
    number = chosen.render.seed if seed is None else seed
    require_compiled()
    kept = out.with_name(f"{out.name}.passes")

    def picture(part: Camera, index: int, report: Progress, checkpoint: Path | None) -> xr.Dataset:
        own_seed = number + 104729 * index
        if samples is None:
            image = render_to_precision(
                scene, part, grid, error, bounces, own_seed, report, percentile, checkpoint, scheduler
            )
        else:
            image = run(scene, part, grid, samples, BATCHES, own_seed, bounces, report)
        return labelled_cube(image)

    with bar("rendering") as report:
        if BATCHES * 4 * view.width_px * view.height_px * grid.size > LARGEST_IN_MEMORY:
            write_in_strips(out, view, picture, report)
        else:
            write_cube(out, picture(view, 0, report, kept))
            kept.unlink(missing_ok=True)
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


def _calibrated_camera(folder: Path) -> Camera:
    from cboxlab.calibration.camera_calibration import calibrate_camera
    from cboxlab.calibration.capture import load_capture

    fit, target, _ = calibrate_camera(load_capture(folder))
    if target is not None and target.survey_camera is not None:
        return target.survey_camera
    if fit is None:
        raise InputError(
            folder / "capture.toml", "no [geometry] with points", "surveyed points, for the camera"
        )
    return fit.camera


def simulate(
    cube: Annotated[Path, typer.Argument(help="Spectral cube: .nc, .exr or .hdr.", show_default=False)],
    out: Annotated[Path, typer.Option(help="The raw frame: 16-bit TIFF, counts.", show_default=False)],
    camera: Annotated[str, typer.Option(help="dcs200, pxl1300l, or a camera file (TOML).")] = "dcs200",
    exposure: Annotated[str, typer.Option(help="Seconds (0.5 or 1/30), or auto.")] = "auto",
    channel: Annotated[
        str | None, typer.Option(help="Filter, of a camera that has several and no mosaic.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the noise.", min=0)] = 0,
    preview: Annotated[Path | None, typer.Option(help="A demosaiced picture (PNG).")] = None,
) -> None:
    """Raw sensor output from any spectral cube."""
    from cboxlab.render.cube_files import read_cube
    from cboxlab.render.sensor_cameras import load_camera

    from .raw_shots import shoot, write_preview, write_shot

    for path, endings in ((out, (".tif", ".tiff")), (preview, (".png",))):
        if path is not None and path.suffix.lower() not in endings:
            raise InputError(path, f"the ending '{path.suffix}'", " or ".join(endings))
        if path is not None:
            require_folder(path.parent)
    sensor = load_camera(camera)
    seconds = None if exposure == "auto" else positive_number(exposure, "--exposure")
    shot = shoot(read_cube(cube), sensor, seconds, seed, channel)
    write_shot(out, shot)
    counts = f"{shot.counts.min()} to {shot.counts.max()} DN"
    say(f"Raw frame: {out} ({sensor.name}, {shot.exposure_s:.4g} s, {counts})")
    if preview is not None:
        write_preview(preview, shot)
        say(f"Preview: {preview}")


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
) -> None:
    """A synthetic capture by the forward model, openly or with a hidden effect and a sealed answer."""
    import numpy as np
    from cboxlab.render.laboratory import CaptureSettings
    from cboxlab.scenes.files import replacing_folder

    from .blind import draw_effect, seal
    from .synthetic import perturbed_camera, write_model_capture

    error = positive_number(noise, "--noise")
    if effects is not None and not hide:
        raise InputError(
            "--effects", "no --hide", "--hide with it", "`cbox add` puts effects into a model openly."
        )
    require_folder(out.parent)
    chosen = _model(model)
    number = secrets.randbits(63) if seed is None else seed
    generator = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    if hide and (effects is not None or not chosen.effects):
        chosen = chosen.with_effect(draw_effect(generator, tuple(effects.split(",")) if effects else ()))
    require_compiled()
    with replacing_folder(out) as temporary:
        with bar("rendering") as report:
            write_model_capture(
                temporary, chosen, perturbed_camera(size, number), CaptureSettings(), number, error, report
            )
        digest = seal(temporary, chosen.effects, generator) if hide else ""
    if hide:
        say(f"Sealed. Keep this hash, so that no answer can change unnoticed: {digest}")
        say(f"Open it with: cbox reveal {out}")
    elif chosen.effects:
        say(f"Effects in it: {', '.join(effect.id for effect in chosen.effects)}")
    say(f"Capture: {out} ({size} x {size} px" + ("" if hide else f", seed {number}") + ")")


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
