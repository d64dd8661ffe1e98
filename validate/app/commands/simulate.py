"""``cbox simulate``: raw frames of spectral cubes by a camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from cboxlab.utils.errors import InputError

from .arguments import DeclareOption, JsonOption
from .console import (
    bar,
    declared_files,
    give_json,
    options,
    positive_number,
    require_file,
    require_folder,
    say,
)

if TYPE_CHECKING:
    import xarray as xr
    from cboxlab.rendering.sensor import SensorCamera

__all__ = ["simulate"]

#: Placeholder in --out and --preview for the name of each cube.
NAME = "{name}"

#: Share of saturated pixels above which a note is printed.
_MANY_SATURATED = 0.5


def simulate(
    cubes: Annotated[
        list[Path],
        typer.Argument(metavar="CUBE...", help="Spectral cubes (.nc, .exr, .hdr).", show_default=False),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="Raw frame: .tif (16-bit counts) or .dng. A name without ending gives a capture folder with darks and "
            "flats. For several cubes, put {name} where the name of each cube belongs.",
            show_default=False,
        ),
    ],
    *,
    camera: Annotated[
        str,
        typer.Option(
            help="Camera: dcs200, dcs420, pxl1300l, nikon-d5100, sigma-sd-merrill, sony-a7r2, or a camera file (TOML)."
        ),
    ] = "dcs200",
    exposure: Annotated[str, typer.Option(help="Exposure time in seconds (0.5 or 1/30), or auto.")] = "auto",
    f_number: Annotated[
        str | None, typer.Option("--f-number", help="Working f-number. The default is the camera's.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Filter of a camera with several filters and no mosaic.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise. Each further cube uses the next number.", min=0)] = 0,
    preview: Annotated[Path | None, typer.Option(help="Also write a demosaiced picture (PNG).")] = None,
    declare: DeclareOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate the raw frames of a camera from spectral cubes."""
    from cboxlab.rendering.files import declared_for, files_of, open_cube, require_used, stated_in
    from cboxlab.rendering.sensor import load_camera

    targets, pictures = _targets(cubes, out, ("", ".tif", ".tiff", ".dng")), [None] * len(cubes)
    if preview is not None:
        pictures = _targets(cubes, preview, (".png",))  # type: ignore[assignment]
    if channel is not None and not out.suffix:
        raise InputError("--channel", f"'{channel}' with a capture folder", "no --channel: a capture has every channel")
    if preview is not None and not out.suffix:
        raise InputError("--preview", "a picture of a capture folder", "a raw frame: --out with .tif or .dng")
    sensor = load_camera(camera)
    if f_number is not None:
        sensor = sensor.at_f_number(positive_number(f_number, "--f-number"))
    seconds = None if exposure == "auto" else positive_number(exposure, "--exposure")
    declared = declared_files(declare)
    lines, frames = [], []
    with options(), bar("simulating") as report:
        for index, (path, target, picture) in enumerate(zip(cubes, targets, pictures, strict=True)):
            with open_cube(path, declared) as cube:
                require_used(declared, declared_for(cube), stated_in(cube))
                try:
                    cube_lines, record = _simulate_one(
                        cube,
                        path.stem,
                        target,
                        picture,
                        sensor,
                        seconds,
                        channel,
                        seed=seed + index,
                        inputs=[*files_of(path), Path(camera)],
                    )
                except InputError as fault:
                    where = str(fault.where).replace("cube:", f"{path}:", 1)
                    raise InputError(where, fault.found, fault.expected, fault.hint) from None
            lines += cube_lines
            frames.append({"cube": path, **record})
            report.part((index + 1) / len(cubes))
    for line in lines:
        say(line)
    give_json(json, {"frames": frames})


def _targets(cubes: list[Path], pattern: Path, endings: tuple[str, ...]) -> list[Path]:
    """Output path of each cube; InputError for another ending, and for equal paths."""
    if pattern.suffix.lower() not in endings:
        expected = " or ".join(ending or "none (a folder)" for ending in endings)
        raise InputError(pattern, f"the ending '{pattern.suffix}'", expected)
    targets = [Path(str(pattern).replace(NAME, cube.stem)) for cube in cubes]
    if len(set(targets)) < len(targets):
        raise InputError(
            pattern, f"one path for {len(cubes)} cubes", f"{NAME} in the path, and cubes with different names"
        )
    for target in targets:
        (require_file if target.suffix else require_folder)(target)
    return targets


def _simulate_one(
    cube: xr.Dataset,
    name: str,
    target: Path,
    picture: Path | None,
    camera: SensorCamera,
    exposure_s: float | None,
    channel: str | None,
    *,
    seed: int,
    inputs: list[Path],
) -> tuple[list[str], dict[str, Any]]:
    """Write the files of one cube; returns lines about them and their record."""
    from cboxlab.rendering.synthetic import write_cube_capture
    from cboxlab.utils.files import replacing_folder

    from ...api import simulate as run
    from ...api import write_manifest

    if not target.suffix:
        with replacing_folder(target) as folder:
            write_cube_capture(folder, cube, camera, exposure_s, seed, name)
            write_manifest(folder, [*folder.iterdir()], inputs, seed=seed)
        return [f"Capture by {camera.name}: {target}"], {"capture": target, "camera": camera.name}
    frame = run(cube, camera, exposure_s=exposure_s, channel=channel, seed=seed)
    frame.write_counts(target)
    counts = f"{frame.counts.min()} to {frame.counts.max()} DN"
    lines = [f"Raw frame by {camera.name}, {frame.exposure_s:.4g} s, {counts}: {target}"]
    saturated = float((frame.counts >= camera.detector.full_scale_dn).mean())
    if saturated > _MANY_SATURATED:
        lines.append(f"• {saturated:.0%} of the pixels are saturated. Use a shorter --exposure.")
    if picture is not None:
        frame.write_preview(picture)
        lines.append(f"Preview: {picture}")
    write_manifest(target, [target], inputs, seed=seed)
    return lines, {"file": target, **frame.to_dict()}
