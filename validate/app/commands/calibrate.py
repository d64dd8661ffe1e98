"""``cbox calibrate``: camera, noise, response, filter weights and scale of a capture."""

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
        bool, typer.Option("--init", help="Only write a first capture.toml for a folder of frames.")
    ] = False,
    refine_geometry: Annotated[
        bool,
        typer.Option("--refine-geometry", help="Fit camera and objects to the box's edges in the photograph."),
    ] = False,
    reference_uncertainty: Annotated[
        float,
        typer.Option(help="Relative standard deviation of the radiance of the reference source.", min=0.0, max=1.0),
    ] = 0.0,
    json: JsonOption = None,
) -> None:
    """Calibrate a capture: camera, noise, linearity, filter weights and absolute scale.

    Quantities for which the capture has no data are left out, with a note.
    """
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
    """Print and write the geometry from the box's edges; returns geometry.json."""
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
    for item in errors:
        sigma = item.covariance.diagonal() ** 0.5
        pairs = zip(item.shift_mm, sigma, strict=True)
        shifts = [f"{shift:+.1f} ± {error:.1f}" if error > 0 else "fixed" for shift, error in pairs]
        rms = [f"{value:.3f}" for value in (item.rms_before_px, item.rms_after_px)]
        cells = [*shifts, str(item.samples), *rms] if item.determined else ["–"] * 3 + [str(item.samples), "–", "–"]
        table.add_row(item.name, *cells)
    print_table(table)
    for item in errors:
        if not item.determined:
            say(f"• The position of {item.name} is not measured: its edges have only {item.samples} samples.")
    say(f"Fitted camera and objects, with covariances: {out / 'geometry.json'}")
    return out / "geometry.json"


def _write_first_manifest(folder: Path, json: Path | None) -> None:
    """Write a first capture.toml, and print what it lacks."""
    from cboxlab.calibration.capture import write_first_manifest

    with bar("reading frames"):
        first = write_first_manifest(folder)
    say(f"{first.path}: {', '.join(f'{count} [[{kind}]]' for kind, count in first.tables.items())}")
    _print_missing("Missing keys. You have to add them before any command accepts the capture:", first, required=True)
    _print_missing("Optional keys, which are used if you add them:", first, required=False)
    if first.left_out:
        say("Files that capture.toml does not use:")
    for item in first.left_out:
        say(f"• {item.file}: {item.why}")
    missing, left_out = [asdict(key) for key in first.missing], [asdict(item) for item in first.left_out]
    give_json(json, {"manifest": first.path, "tables": first.tables, "missing": missing, "left_out": left_out})


def _print_missing(title: str, first: FirstManifest, *, required: bool) -> None:
    """Print missing keys below a title, if there are any."""
    alike: dict[tuple[str, str, str], list[str]] = {}  # the same key of several tables is one line
    for key in first.missing:
        if key.required == required:
            alike.setdefault((key.where.partition(" of ")[0], key.example, key.why), []).append(str(key))
    lines = [f"• {same[0]}" + (f" (and {len(same) - 1} more)" if same[1:] else "") for same in alike.values()]
    for line in [title, *lines] if lines else []:
        say(line)
