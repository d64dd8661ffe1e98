"""``cbox renderers``: other renderers run on a box and compared."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import (
    bar,
    data_table,
    give_json,
    options,
    print_table,
    require_folder,
    say,
    warn_unless_compiled,
    wavelengths,
)

if TYPE_CHECKING:
    from ...compare_renders.renderers import ComparedRenderers, Judged

__all__ = ["renderers"]

#: Channels of an export and of a comparison.
_WAVELENGTHS = "400:700:20"


def renderers(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", help="Model or scene file (TOML), or a packaged scene: cornell-box."),
    ] = None,
    *,
    chosen: Annotated[
        str | None,
        typer.Option(
            "--with",
            help="Renderers, joined by commas, in place of those that run by default; those not installed are named "
            "and left out.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A new folder for the export, cubes, bias maps and renderers.json.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="In place of --size: a camera file (.json), or a capture folder.")
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels per side, for the published camera.", min=16, max=1024)] = 64,
    at: Annotated[str, typer.Option("--wavelengths", help="first:last:step in nm, or a list a,b,c.")] = "400:700:50",
    samples: Annotated[int, typer.Option(help="Samples per pixel and batch.", min=1)] = 256,
    collect: Annotated[
        Path | None,
        typer.Option(help="Run nothing: write cubes of what was rendered in this folder of `cbox export`."),
    ] = None,
    references: Annotated[
        bool, typer.Option("--references", help="Measure our own integrators against closed forms instead.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Run other renderers on a box and compare each with our reference: differences, noise, time, named cause."""
    if collect is not None:
        _collect(collect, json)
        return
    if references:
        _references(json)
        return
    if model is None:
        raise InputError("MODEL", "no model", "a model file or cornell-box; or --collect FOLDER, or --references")
    from cboxlab.rendering.export import ExportSettings
    from cboxlab.rendering.model import load_model

    from ...api import MANIFEST, write_manifest
    from ...compare_renders.renderers import compare_renderers, exported_model

    names = _names(chosen)
    for path in (out, json):
        if path is not None:
            require_folder(path.parent)
    warn_unless_compiled()
    settings, box = ExportSettings(wavelengths(at), samples), load_model(model)
    with options(renderer="--with"), bar("rendering") as report:
        compared = compare_renderers(exported_model(box, camera, size, settings), names, out, report)
        if out is not None:
            inputs = [*box.files, Path(model), *([] if camera is None else [camera])]
            written = [path for path in out.iterdir() if path.name != MANIFEST]
            write_manifest(out, written, inputs, seed=box.render.seed)
    give_json(json, compared.to_dict())
    for line in compared.left_out:
        say(f"• {line}")
    _print(compared)
    if out is not None:
        say(f"Export, cubes, bias maps, renderers.json: {out}")
    if compared.failed:
        from cboxlab.utils.faults import combined

        raise combined(compared.failed)


def _names(text: str | None) -> list[str]:
    from cboxlab.rendering.export import renderer_catalogue, renderer_of

    if text is None:
        return [name for name, renderer in renderer_catalogue().items() if renderer.by_default]
    return [renderer_of(name.strip(), "--with").id for name in text.split(",")]


def _collect(folder: Path, json: Path | None) -> None:
    from cboxlab.rendering.export import read_rendered, renderer_catalogue
    from cboxlab.rendering.files import write_cube
    from cboxlab.utils.files import origin

    done = [name for name in renderer_catalogue() if (folder / name / "out").is_dir()]
    if not done:
        raise InputError(folder, "nothing rendered", "an export with pictures in RENDERER/out")
    if json is not None:
        require_folder(json.parent)
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
    from ...compare_renders.renderers import measure_closed_forms

    if json is not None:
        require_folder(json.parent)
    warn_unless_compiled()
    with bar("measuring") as report:
        found = measure_closed_forms(progress=report)
    give_json(json, {"references": [row.to_dict() for row in found]})
    table = data_table("Against closed forms", "reference", "integrator", "expected", "difference, %", "± %")
    for row in found:
        numbers = f"{row.expected:.6g}", f"{100 * row.difference:+.4f}", f"{100 * row.sigma:.4f}"
        table.add_row(row.name, row.integrator, *numbers)
    print_table(table)


def _print(compared: ComparedRenderers) -> None:
    if not compared.judged:
        return
    names = [judged.renderer for judged in compared.judged]
    table = data_table("Difference to our reference, % ± standard deviation", "surface", *names)
    for surface in compared.judged[0].surfaces:
        cells = [f"{100 * j.surfaces[surface][0]:+.2f} ± {100 * j.surfaces[surface][1]:.2f}" for j in compared.judged]
        table.add_row(surface, *cells)
    print_table(table)
    table = data_table("By wavelength, %", "nm", *names)
    for index, nm in enumerate(compared.judged[0].wavelength_nm):
        table.add_row(f"{nm:g}", *(_band(judged, index) for judged in compared.judged))
    print_table(table)
    table = data_table("Noise and time", "renderer", "error, %", "CPU s", "elapsed s", "variance × CPU s")
    for name, variance, cpu, wall in compared.costs:
        table.add_row(name, f"{100 * variance**0.5:.3g}", f"{cpu:.1f}", f"{wall:.1f}", f"{variance * cpu:.3g}")
    print_table(table)
    for judged in compared.judged:
        say(f"{judged.renderer}: {judged.sentence}")
        if judged.remark:
            say(f"• {judged.renderer} is compared with our picture of its own scene: {judged.remark}")


def _band(judged: Judged, index: int) -> str:
    for row in judged.outcome.of_kind("band"):
        if row.name == f"{judged.wavelength_nm[index]:.10g}":
            return f"{100 * row.difference:+.2f} ± {100 * row.sigma:.2f}"
    return "no light"
