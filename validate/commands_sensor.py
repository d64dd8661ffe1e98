"""The command from spectral cubes to raw frames: simulate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.scenes.errors import InputError

from .console import bar, positive_number, require_folder, say

if TYPE_CHECKING:
    from cboxlab.render.sensor import SensorCamera

__all__ = ["simulate"]

#: Stands in --out and --preview for the name of each cube's file.
NAME = "{name}"


def simulate(
    cubes: Annotated[
        list[Path],
        typer.Argument(metavar="CUBE...", help="Spectral cubes: .nc, .exr or .hdr.", show_default=False),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="Raw frame: .tif (16 bits, counts) or .dng; without ending a capture folder with darks and "
            "flats. {name} stands for the cube's name, for several cubes.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        str,
        typer.Option(
            help="dcs200, dcs420, pxl1300l, nikon-d5100, sigma-sd-merrill, sony-a7r2, or a camera file (TOML)."
        ),
    ] = "dcs200",
    exposure: Annotated[str, typer.Option(help="Seconds (0.5 or 1/30), or auto.")] = "auto",
    f_number: Annotated[
        str | None, typer.Option("--f-number", help="Working f-number, in place of the camera's.")
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Filter, of a camera that has several and no mosaic.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the noise; each further cube takes the next.", min=0)] = 0,
    preview: Annotated[Path | None, typer.Option(help="A demosaiced picture (PNG).")] = None,
) -> None:
    """Raw sensor output from any spectral cube."""
    from cboxlab.render.sensor_cameras import load_camera

    targets, pictures = _targets(cubes, out, ("", ".tif", ".tiff", ".dng")), [None] * len(cubes)
    if preview is not None:
        pictures = _targets(cubes, preview, (".png",))  # type: ignore[assignment]
    if channel is not None and not out.suffix:
        raise InputError(
            "--channel", f"'{channel}' with a capture folder", "none: a capture takes every channel"
        )
    if preview is not None and not out.suffix:
        raise InputError("--preview", "a picture of a capture folder", "one frame, --out .tif or .dng")
    sensor = load_camera(camera)
    if f_number is not None:
        sensor = sensor.at_f_number(positive_number(f_number, "--f-number"))
    seconds = None if exposure == "auto" else positive_number(exposure, "--exposure")
    lines = []
    with bar("simulating") as report:
        for index, (path, target, picture) in enumerate(zip(cubes, targets, pictures, strict=True)):
            lines += _one(path, target, picture, sensor, seconds, channel, seed + index)
            report((index + 1) / len(cubes))
    for line in lines:
        say(line)


def _targets(cubes: list[Path], pattern: Path, endings: tuple[str, ...]) -> list[Path]:
    """Where each cube's result goes. Raises InputError for another ending, or one place for several cubes."""
    if pattern.suffix.lower() not in endings:
        known = " or ".join(ending or "none (a folder)" for ending in endings)
        raise InputError(pattern, f"the ending '{pattern.suffix}'", known)
    targets = [Path(str(pattern).replace(NAME, cube.stem)) for cube in cubes]
    if len(set(targets)) < len(targets):
        raise InputError(
            pattern, f"one place for {len(cubes)} cubes", f"{NAME} in it, and cubes of different names"
        )
    for target in targets:
        require_folder(target.parent)
    return targets


def _one(
    path: Path,
    target: Path,
    picture: Path | None,
    camera: SensorCamera,
    exposure_s: float | None,
    channel: str | None,
    seed: int,
) -> list[str]:
    """One cube's files, and what to tell of them."""
    from cboxlab.render.cube_capture import write_cube_capture
    from cboxlab.render.cube_files import open_cube

    from .raw_shots import shoot, write_preview, write_shot

    with open_cube(path) as cube:
        if not target.suffix:
            write_cube_capture(target, cube, camera, exposure_s, seed, path.stem)
            return [f"Capture: {target} ({camera.name})"]
        shot = shoot(cube, camera, exposure_s, seed, channel)
    write_shot(target, shot)
    counts = f"{shot.counts.min()} to {shot.counts.max()} DN"
    told = [f"Raw frame: {target} ({camera.name}, {shot.exposure_s:.4g} s, {counts})"]
    if picture is not None:
        write_preview(picture, shot)
        told.append(f"Preview: {picture}")
    return told
