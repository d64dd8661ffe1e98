"""``cbox export``: write a box for other renderers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import LARGEST_SIZE, ModelArgument
from .console import (
    bar,
    options,
    require_folder,
    say,
    warn_unless_compiled,
    wavelengths,
)

__all__ = ["export"]

#: Default wavelengths of an export.
_WAVELENGTHS = "400:700:20"


def export(
    model: ModelArgument,
    to: Annotated[Path, typer.Option(help="New folder of the export.", show_default=False)],
    *,
    camera: Annotated[
        Path | None,
        typer.Option(help="Camera file (.json), or capture folder for its camera and lamp. It replaces --size."),
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels per side of the published camera.", min=2, max=LARGEST_SIZE)] = 128,
    at: Annotated[
        str, typer.Option("--wavelengths", help="Wavelengths in nm: first:last:step, or a list a,b,c.")
    ] = _WAVELENGTHS,
    samples: Annotated[int, typer.Option(help="Samples per pixel and batch.", min=1)] = 64,
    batches: Annotated[
        int, typer.Option(help="Number of independent runs, whose scatter gives the standard error.", min=2, max=64)
    ] = 4,
    subpixels: Annotated[int, typer.Option(help="Rays per pixel and axis in the file of rays.", min=1, max=16)] = 4,
) -> None:
    """Write a box for other renderers, as neutral files and as input files of known renderers.

    When a renderer has run, `cbox renderers --collect` makes a cube of its pictures.
    """
    from cboxlab.rendering.export import ExportSettings, renderer_catalogue, write_export
    from cboxlab.rendering.model import load_model

    from ...compare_renders.renderers import exported_model

    settings = ExportSettings(wavelengths(at), samples, batches, subpixels)
    require_folder(to.parent)
    warn_unless_compiled()
    with options(), bar("exporting"):
        write_export(to, exported_model(load_model(model), camera, size, settings))
    count = settings.wavelength_nm.size
    unit = "wavelength" if count == 1 else "wavelengths"
    say(f"Export of {count} {unit} for {', '.join(renderer_catalogue())}: {to}")
