"""``cbox export``: a box for other renderers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    pass

__all__ = ["export"]

#: Channels of an export and of a comparison.
_WAVELENGTHS = "400:700:20"


def export(
    model: ModelArgument,
    to: Annotated[Path, typer.Option(help="A new folder.", show_default=False)],
    *,
    camera: Annotated[
        Path | None,
        typer.Option(help="In place of --size: a camera file (.json), or a capture folder (its camera and lamp)."),
    ] = None,
    size: Annotated[
        int, typer.Option(help="Pixels per side, for the published camera.", min=2, max=LARGEST_SIZE)
    ] = 128,
    at: Annotated[str, typer.Option("--wavelengths", help="first:last:step in nm, or a list a,b,c.")] = _WAVELENGTHS,
    samples: Annotated[int, typer.Option(help="Samples per pixel and batch.", min=1)] = 64,
    batches: Annotated[int, typer.Option(help="Independent runs, whose scatter gives the error.", min=2, max=64)] = 4,
    subpixels: Annotated[int, typer.Option(help="Rays of the ray file per pixel and axis.", min=1, max=16)] = 4,
) -> None:
    """Write a box for other renderers: neutral files, and files ready to run for each known renderer.

    `cbox renderers --collect` makes a cube of what a renderer wrote.
    """
    from cboxlab.rendering.export import ExportSettings, renderer_catalogue, write_export
    from cboxlab.rendering.model import load_model

    from ...compare_renders.renderers import exported_model

    settings = ExportSettings(wavelengths(at), samples, batches, subpixels)
    require_folder(to.parent)
    warn_unless_compiled()
    with options(), bar("exporting"):
        write_export(to, exported_model(load_model(model), camera, size, settings))
    say(f"Export: {to} ({settings.wavelength_nm.size} wavelengths; {', '.join(renderer_catalogue())})")
