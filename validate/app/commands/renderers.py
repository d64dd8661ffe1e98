"""``cbox renderers``: run other renderers on a box and compare them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import (
    bar,
    give_json,
    options,
    print_result,
    require_folder,
    say,
    warn_unless_compiled,
    wavelengths,
)

__all__ = ["renderers"]


def renderers(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", help="Model or scene file (TOML), or the packaged scene cornell-box."),
    ] = None,
    *,
    requested: Annotated[
        str | None,
        typer.Option(
            "--with",
            help="Renderers, joined by commas. The default is Mitsuba, Radiance and Raysect. Renderers that are not "
            "installed are left out, with a note.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="New folder for the export, cubes, bias maps and renderers.json.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="Camera file (.json), or capture folder. It replaces --size.")
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels per side of the published camera.", min=16, max=1024)] = 64,
    at: Annotated[
        str, typer.Option("--wavelengths", help="Wavelengths in nm: first:last:step, or a list a,b,c.")
    ] = "400:700:50",
    samples: Annotated[int, typer.Option(help="Samples per pixel and batch.", min=1)] = 256,
    collect: Annotated[
        Path | None,
        typer.Option(help="Run nothing. Make cubes of the pictures that renderers wrote to this export folder."),
    ] = None,
    references: Annotated[
        bool, typer.Option("--references", help="Only compare our integrators with closed forms.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Run other renderers on a box, and compare each with the reference of cboxlab.

    The command prints differences, noise, time, and the probable cause of a difference.
    """
    if collect is not None:
        _collect(collect, json)
        return
    if references:
        _references(json)
        return
    if model is None:
        raise InputError("MODEL", "no model", "a model file or cornell-box, --collect FOLDER, or --references")
    from cboxlab.rendering.export import ExportSettings
    from cboxlab.rendering.model import load_model

    from ...api import MANIFEST, write_manifest
    from ...compare_renders.renderers import compare_renderers, exported_model

    names = _names(requested)
    if out is not None:
        require_folder(out.parent)
    warn_unless_compiled()
    settings, box = ExportSettings(wavelengths(at), samples), load_model(model)
    with options(renderer="--with"), bar("rendering") as report:
        compared = compare_renderers(exported_model(box, camera, size, settings), names, out, report)
        if out is not None:
            inputs = [*box.files, Path(model), *([] if camera is None else [camera])]
            written = [path for path in out.iterdir() if path.name != MANIFEST]
            write_manifest(out, written, inputs, seed=box.render.seed)
    give_json(json, compared.to_dict())
    print_result(compared.lines(), compared.tables())
    if out is not None:
        say(f"Export, cubes, bias maps and renderers.json: {out}")
    if compared.failed:
        from cboxlab.utils.faults import combined

        raise combined(compared.failed)


def _names(text: str | None) -> list[str]:
    """Identifiers of the renderers to run."""
    from cboxlab.rendering.export import renderer_catalogue, renderer_of

    if text is None:
        return [name for name, renderer in renderer_catalogue().items() if renderer.by_default]
    return [renderer_of(name.strip(), "--with").id for name in text.split(",")]


def _collect(folder: Path, json: Path | None) -> None:
    """Write cubes of the pictures in an export."""
    from cboxlab.rendering.export import read_rendered, renderer_catalogue
    from cboxlab.rendering.files import write_cube
    from cboxlab.utils.files import origin

    done = [name for name in renderer_catalogue() if (folder / name / "out").is_dir()]
    if not done:
        raise InputError(folder, "no pictures of a renderer", "an export with pictures in RENDERER/out")
    cubes, unfinished = {}, []
    for name in done:
        try:
            cube = read_rendered(folder, name)
        except InputError as error:
            unfinished.append(error)
            continue
        cubes[name] = folder / f"{name}.nc"
        write_cube(cubes[name], cube.assign_attrs(origin(renderer=name)))
        say(f"Cube: {cubes[name]}")
    give_json(json, {"cubes": cubes})
    if unfinished:
        from cboxlab.utils.faults import combined

        raise combined(unfinished)


def _references(json: Path | None) -> None:
    """Print the errors of our integrators."""
    from ...compare_renders.renderers import closed_form_table, measure_closed_forms

    warn_unless_compiled()
    with bar("measuring") as report:
        measured = measure_closed_forms(progress=report)
    give_json(json, {"references": [row.to_dict() for row in measured]})
    print_result([], [closed_form_table(measured)])
