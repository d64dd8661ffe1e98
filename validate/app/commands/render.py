"""``cbox render``: a spectral cube of a model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import LARGEST_SIZE, JsonOption, ModelArgument
from .console import (
    bar,
    choose_device,
    data_table,
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
    from cboxlab.rendering.photometry import Photometry


__all__ = ["render"]


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
