"""``cbox calibrate``: camera, noise, response, filter weights and absolute scale of a capture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import CaptureFolder, JsonOption
from .console import (
    bar,
    data_table,
    give_json,
    print_result,
    print_table,
    require_folder,
    say,
)

if TYPE_CHECKING:
    from cboxlab.calibration.capture import FirstManifest
    from cboxlab.calibration.result import Calibration


__all__ = ["calibrate"]


def calibrate(
    capture: CaptureFolder,
    out: Annotated[Path, typer.Option(help="Folder for calibration.json, plots and patches.csv.")] = Path(
        "calibration-report"
    ),
    init: Annotated[
        bool, typer.Option("--init", help="Write a first capture.toml for a folder of frames, and stop.")
    ] = False,
    refine_geometry: Annotated[
        bool,
        typer.Option("--refine-geometry", help="Compare the box's edges in the photograph with the model's."),
    ] = False,
    reference_uncertainty: Annotated[
        float,
        typer.Option(help="Relative standard deviation of the reference source's radiance.", min=0.0, max=1.0),
    ] = 0.0,
    json: JsonOption = None,
) -> None:
    """Calibrate camera, noise, linearity, filter weights and absolute scale, as far as a capture allows."""
    if init:
        _write_first_manifest(capture, json)
        return
    from ...api import calibrate as run
    from ...api import write_manifest

    require_folder(out)
    with bar("calibrating"):
        result = run(capture, reference_uncertainty=reference_uncertainty)
    written = [*result.write(out)]
    print_result(result.lines(), result.tables())
    if refine_geometry:
        written.append(_refine_geometry(result.calibration, out))
    write_manifest(out, written, [capture])
    give_json(json, result.to_dict())
    say(f"Calibration: {out / 'calibration.json'}")


def _refine_geometry(calibration: Calibration, out: Path) -> Path:
    from cboxlab.calibration.result import write_geometry

    from ...compare import refine_geometry

    camera, errors = refine_geometry(calibration)
    write_geometry(camera, [error.record for error in errors], out)
    table = data_table(
        "Geometry from edges: photograph minus model",
        "object",
        "x, mm",
        "y, mm",
        "z, mm",
        "samples",
        "rms, px",
        "rms after fit, px",
    )
    for error in errors:
        sigma = error.covariance.diagonal() ** 0.5
        pairs = zip(error.shift_mm, sigma, strict=True)
        shifts = [f"{shift:+.1f} ± {one:.1f}" if one > 0 else "fixed" for shift, one in pairs]
        rms = [f"{value:.3f}" for value in (error.rms_before_px, error.rms_after_px)]
        cells = [*shifts, str(error.samples), *rms] if error.known else ["–"] * 3 + [str(error.samples), "–", "–"]
        table.add_row(error.name, *cells)
    print_table(table)
    for error in errors:
        if not error.known:
            say(f"• {error.name}: {error.samples} samples along its edges are too few to tell where it stands")
    say(f"Refined camera and objects, with covariances: {out / 'geometry.json'}")
    return out / "geometry.json"


def _write_first_manifest(folder: Path, json: Path | None) -> None:
    from cboxlab.calibration.capture import write_first_manifest

    with bar("reading frames"):
        first = write_first_manifest(folder)
    say(f"{first.path}: {', '.join(f'{count} [[{kind}]]' for kind, count in first.tables.items())}")
    _print_missing("Missing. Every command refuses the capture until these are there:", first, required=True)
    _print_missing("Can be added, and is then used:", first, required=False)
    if first.left_out:
        say("Files that capture.toml does not name:")
    for item in first.left_out:
        say(f"• {item.file}: {item.why}")
    missing, left_out = [asdict(key) for key in first.missing], [asdict(item) for item in first.left_out]
    give_json(json, {"manifest": first.path, "tables": first.tables, "missing": missing, "left_out": left_out})


def _print_missing(title: str, first: FirstManifest, *, required: bool) -> None:
    alike: dict[tuple[str, str, str], list[str]] = {}  # the same key of several tables is one line
    for key in first.missing:
        if key.required == required:
            alike.setdefault((key.where.partition(" of ")[0], key.example, key.why), []).append(str(key))
    lines = [f"• {same[0]}" + (f" (and {len(same) - 1} more)" if same[1:] else "") for same in alike.values()]
    for line in [title, *lines] if lines else []:
        say(line)
