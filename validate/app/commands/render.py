"""``cbox render``: render a spectral cube of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import LARGEST_SIZE, JsonOption, ModelArgument
from .console import (
    bar,
    choose_device,
    give_json,
    options,
    positive_number,
    print_result,
    require_file,
    say,
    this_run,
    warn_unless_compiled,
    wavelengths,
)

__all__ = ["render"]


def render(
    model: ModelArgument,
    out: Annotated[
        Path,
        typer.Option(
            help="File of the cube: .nc (with standard errors), .exr, .hdr (ENVI) or .png.", show_default=False
        ),
    ],
    *,
    at: Annotated[
        str, typer.Option("--wavelengths", help="Wavelengths in nm: first:last:step, or a list a,b,c.")
    ] = "400:700:10",
    size: Annotated[int, typer.Option(help="Pixels per side of the published camera.", min=2, max=LARGEST_SIZE)] = 256,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="Camera file (.json), or capture folder for its calibrated camera and lamp. It replaces --size."
        ),
    ] = None,
    noise: Annotated[
        str, typer.Option(help="Relative standard error per pixel and wavelength at which rendering stops.")
    ] = "0.3%",
    percentile: Annotated[
        float, typer.Option(help="Percentile of the pixels' errors to which --noise applies.", min=1, max=100)
    ] = 50.0,
    samples: Annotated[
        int | None, typer.Option(help="Samples per pixel and batch. It replaces --noise.", min=1)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the random numbers. The default is the model's.", min=0)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers share the rendering.")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(help="Device: cpu or cuda. The default is the environment variable CBOX_DEVICE, or else cpu."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Render a spectral cube of a model: the light before filters and sensor.

    If you interrupt the command, the same command continues later. Finished parts are stored next to the cube, as
    CUBE.passes or, for a large cube, in the folder CUBE.strips.
    """
    choose_device(device)
    from cboxlab.rendering.files import WRITABLE, files_of
    from cboxlab.rendering.model import load_model
    from cboxlab.scenes.cornell_box import cornell_camera

    from ...api import CubeSettings, render_file, write_manifest

    if out.suffix.lower() not in WRITABLE:
        raise InputError(out, f"the ending '{out.suffix}'", f"one of {', '.join(WRITABLE)}")
    grid, error = wavelengths(at), positive_number(noise, "--noise")
    require_file(out)
    checked = load_model(model)
    warn_unless_compiled()
    settings = CubeSettings(grid, error, percentile, samples, seed, scheduler, this_run.command)
    with options(scheduler="--scheduler"), bar("rendering") as report:
        cube = render_file(out, checked, camera or cornell_camera(size), settings, report)
        inputs = [*checked.files, Path(model), *([] if camera is None else [camera])]
        write_manifest(out, files_of(out), inputs, seed=checked.render.seed if seed is None else seed)
    print_result(cube.lines(), cube.tables())
    record = {
        "cube": out,
        "width_px": cube.width_px,
        "height_px": cube.height_px,
        "wavelength_nm": grid.tolist(),
        "notes": cube.notes,
        "photometry": None if cube.photometry is None else cube.photometry.to_dict(),
    }
    give_json(json, record)
    say(f"Cube: {out}")
