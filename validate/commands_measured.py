"""Commands on captures: demo, validate, calibrate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import bar, console, data_table, require_compiled, require_folder, say

if TYPE_CHECKING:
    from cboxlab.calibration.calibrate import Calibration

    from .stacks import StackComparison

__all__ = ["NoCacheOption", "RenderOption", "calibrate", "compare", "demo", "validate"]

CaptureFolder = Annotated[
    Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)
]

RenderOption = Annotated[
    Path | None,
    typer.Option(
        help="Another renderer's spectral cube (.nc, .exr, .hdr) through the capture's calibrated camera."
    ),
]
NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Render afresh, and keep no picture in the user's cache folder.")
]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the report and the pictures.")] = Path("demo-report"),
) -> None:
    """The whole chain on the bundled capture."""
    from .demo import run_demo

    require_folder(out)
    require_compiled()
    run_demo(out)


def validate(
    capture: CaptureFolder,
    model: Annotated[
        Path | None, typer.Option(help="Model file (TOML); the published box where left out.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for report.html, metrics.json and maps.")] = Path(
        "validation"
    ),
    render: RenderOption = None,
    no_cache: NoCacheOption = False,
) -> None:
    """The main job: calibrate, render, compare, report."""
    from .model import Model, load_model
    from .picture_cache import default_cache
    from .pipeline import validate as run
    from .pipeline import write_validation
    from .summary import print_validation

    require_folder(out)
    chosen = Model() if model is None else load_model(model)
    require_compiled()
    with bar("validating") as report:
        result = run(capture, chosen, report, render, None if no_cache else default_cache())
    write_validation(result, out)
    print_validation(result)
    say(f"Report: {out / 'report.html'}")


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
        typer.Option(
            help="Relative standard deviation of the reference source's radiance.", min=0.0, max=1.0
        ),
    ] = 0.0,
) -> None:
    """Camera, noise, linearity, filter weights, absolute scale, as far as a capture allows."""
    if init:
        _write_first_manifest(capture)
        return
    from cboxlab.calibration.calibrate import calibrate as run
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.write_calibration import write_calibration

    require_folder(out)
    with bar("calibrating"):
        calibration = run(load_capture(capture), reference_uncertainty)
    write_calibration(calibration, out)
    _print_calibration(calibration)
    for note in calibration.notes:
        say(f"• {note}")
    if refine_geometry:
        _refine_geometry(calibration, out)
    say(f"Calibration: {out / 'calibration.json'}")


def _refine_geometry(calibration: Calibration, out: Path) -> None:
    from cboxlab.calibration.edge_alignment import refine_geometry
    from cboxlab.calibration.write_calibration import write_geometry

    camera, errors = refine_geometry(calibration)
    write_geometry(camera, errors, out)
    table = data_table(
        "Geometry by edges: photograph less model", "object", "x, mm", "y, mm", "z, mm", "samples",
        "rms, px", "left, px",
    )  # fmt: skip
    for error in errors:
        sigma = error.covariance.diagonal() ** 0.5
        pairs = zip(error.shift_mm, sigma, strict=True)
        shifts = [f"{shift:+.1f} ± {one:.1f}" if one > 0 else "held" for shift, one in pairs]
        table.add_row(
            error.name, *shifts, str(error.samples), f"{error.rms_before_px:.3f}", f"{error.rms_after_px:.3f}"
        )
    console.print(table)
    say(f"Refined camera and objects, with covariances: {out / 'geometry.json'}")


def _write_first_manifest(folder: Path) -> None:
    from cboxlab.calibration.first_manifest import write_first_manifest

    with bar("reading frames"):
        first = write_first_manifest(folder)
    say(f"{first.path}: {', '.join(f'{count} [[{kind}]]' for kind, count in first.tables.items())}")
    say("Still to add or to check:")
    for line in first.missing:
        say(f"• {line}")


def _print_calibration(calibration: Calibration) -> None:
    from cboxlab.calibration.patch_colour import patch_errors

    from .calibration_rows import calibration_rows, colour_rows, patch_rows

    table = data_table(
        calibration.capture.manifest.name or calibration.capture.folder.name, "", "value", "± 1 σ", "unit"
    )
    for row in calibration_rows(calibration):
        table.add_row(*row)
    console.print(table)
    if calibration.colour is not None:
        errors = data_table(
            "Filter weights: rms error, mean and largest colour difference", "weights", "X, %", "Y, %", "Z, %",
            "ΔE*ab", "CIEDE2000",
        )  # fmt: skip
        for method in colour_rows(calibration.colour):
            errors.add_row(*method)
        console.print(errors)
    if calibration.patches is not None:
        colours = data_table("Patches", "patch", "X", "Y", "Z", "σ(Y)", "true Y", "Δρ", "ΔE*ab", "ΔE00")
        errors_of_patches = patch_errors(calibration.patches, calibration.capture.label_reflectances())
        for patch in patch_rows(calibration.patches, errors_of_patches):
            colours.add_row(*patch)
        console.print(colours)


def compare(
    a: Annotated[
        Path, typer.Argument(help="Cube (.nc, .exr, .hdr), map (.exr) or capture folder.", show_default=False)
    ],
    b: Annotated[Path, typer.Argument(help="The reference: another of the same kind.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for maps and comparison.json.")] = None,
) -> None:
    """Two cubes, images or captures: maps and tables of (A − B) / B."""
    from .stacks import compare_stacks, read_stack, write_comparison

    if out is not None:
        require_folder(out)
    with bar("comparing"):
        comparison = compare_stacks(read_stack(a), read_stack(b))
    if out is not None:
        write_comparison(out, comparison)
    _print_comparison(comparison)
    if out is not None:
        say(f"Maps: {out}")


def _shown(value: float | None, form: str) -> str:
    """A dash for what is not known."""
    return "–" if value is None or value != value else format(value, form)


def _print_comparison(comparison: StackComparison) -> None:
    table = data_table(
        f"{comparison.first.source.name} against {comparison.second.source.name}, in {comparison.first.unit}",
        "plane", "mean A", "mean B", "mean difference, %", "rms, %", "pixels", "χ²/pixel",
    )  # fmt: skip
    for row in comparison.rows:
        table.add_row(
            row.name,
            f"{row.mean_first:.4g}",
            f"{row.mean_second:.4g}",
            _shown(100 * row.relative_mean, "+.3f"),
            _shown(100 * row.relative_rms, ".3f"),
            str(row.pixels),
            _shown(row.chi2_per_pixel, ".3f"),
        )
    console.print(table)
    worst = data_table("Worst pixels", "plane", "x", "y", "A", "B", comparison.worst_measure)
    for pixel in comparison.worst:
        worst.add_row(
            pixel.plane,
            str(pixel.x),
            str(pixel.y),
            f"{pixel.first:.4g}",
            f"{pixel.second:.4g}",
            f"{pixel.size:+.4g}",
        )
    if comparison.residual_over_sigma is not None:
        say(f"Noise alone gives a χ² per pixel of {comparison.expected_chi2:.2f}.")
    if comparison.worst:
        console.print(worst)
    for note in comparison.notes:
        say(f"• {note}")
