"""Commands on captures and their results: demo, validate, calibrate, compare, verify."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import (
    DeclareOption,
    DeclarePairOption,
    JsonOption,
    bar,
    data_table,
    declared_files,
    declared_pair,
    give_json,
    model_for,
    options,
    print_table,
    require_folder,
    say,
    warn_unless_compiled,
)

if TYPE_CHECKING:
    from cboxlab.calibration.capture import FirstManifest
    from cboxlab.calibration.result import Calibration

    from ...compare_renders import StackComparison

__all__ = ["NoCacheOption", "RenderOption", "calibrate", "compare", "demo", "validate", "verify"]

CaptureFolder = Annotated[
    Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)
]

RenderOption = Annotated[
    Path | None,
    typer.Option(help="Spectral cube of another renderer (.nc, .exr, .hdr), with the capture's calibrated camera."),
]
NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Do not use or write rendered pictures in the user's cache folder.")
]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the report and the pictures.")] = Path("demo-report"),
) -> None:
    """Run the whole chain on the bundled capture."""
    from .demo import run_demo

    require_folder(out)
    warn_unless_compiled()
    run_demo(out)


def validate(
    capture: CaptureFolder,
    *,
    model: Annotated[
        Path | None,
        typer.Option(help="Model or scene file (TOML); default the capture's scene."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for report.html, metrics.json and maps.")] = Path("validation"),
    render: RenderOption = None,
    no_cache: NoCacheOption = False,
    declare: DeclareOption = None,
    json: JsonOption = None,
) -> None:
    """Calibrate a capture, render the model, compare and write a report."""
    from ...api import validate as run
    from ...api import write_manifest
    from ...predict import default_cache
    from .summary import print_validation

    require_folder(out)
    declared = declared_files(declare)
    chosen, cache = model_for(model, [capture]), None if no_cache else default_cache()
    warn_unless_compiled()
    with options(render="--render"), bar("calibrating") as report:
        result = run(capture, model=chosen, render=render, cache=cache, declared=declared, progress=report)
        report.stage("writing the report")
        inputs = [path for path in (capture, model, render, *chosen.files) if path is not None]
        write_manifest(out, result.write(out), inputs, seed=chosen.render.seed)
    print_validation(result.validation)
    give_json(json, result.to_dict())
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
    from .summary import print_suspicions

    require_folder(out)
    with bar("calibrating"):
        result = run(capture, reference_uncertainty=reference_uncertainty)
    written = [*result.write(out)]
    calibration = result.calibration
    _print_calibration(calibration)
    print_suspicions(calibration)
    for note in calibration.notes:
        say(f"• {note}")
    if refine_geometry:
        written.append(_refine_geometry(calibration, out))
    write_manifest(out, written, [capture])
    give_json(json, result.to_dict())
    say(f"Calibration: {out / 'calibration.json'}")


def _refine_geometry(calibration: Calibration, out: Path) -> Path:
    from cboxlab.calibration.result import refine_geometry, write_geometry

    camera, errors = refine_geometry(calibration)
    write_geometry(camera, errors, out)
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


def _print_calibration(calibration: Calibration) -> None:
    from cboxlab.calibration.colour import patch_errors

    from ...report import calibration_rows, colour_rows, patch_rows

    table = data_table(
        calibration.capture.manifest.name or calibration.capture.folder.name, "", "value", "± 1 σ", "unit"
    )
    for row in calibration_rows(calibration):
        table.add_row(*row)
    print_table(table)
    if calibration.colour is not None:
        errors = data_table(
            "Filter weights: rms error, mean and largest colour difference",
            "weights",
            "X, %",
            "Y, %",
            "Z, %",
            "ΔE*ab",
            "CIEDE2000",
        )
        for method in colour_rows(calibration.colour):
            errors.add_row(*method)
        print_table(errors)
    if calibration.patches is not None:
        colours = data_table("Patches", "patch", "X", "Y", "Z", "σ(Y)", "true Y", "Δρ", "ΔE*ab", "ΔE00")
        errors_of_patches = patch_errors(calibration.patches, calibration.capture.label_reflectances())
        for patch in patch_rows(calibration.patches, errors_of_patches):
            colours.add_row(*patch)
        print_table(colours)


def compare(
    a: Annotated[
        Path,
        typer.Argument(help="Cube or picture (.nc, .exr, .hdr), map (.exr) or capture folder.", show_default=False),
    ],
    b: Annotated[Path, typer.Argument(help="The reference, of the same kind.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for maps and comparison.json.")] = None,
    declare: DeclarePairOption = None,
    json: JsonOption = None,
) -> None:
    """Compare two cubes, maps or captures: maps and tables of (A − B) / B."""
    from ...api import write_manifest
    from ...compare_renders import compare_stacks, comparison_record, read_stack, write_comparison

    if out is not None:
        require_folder(out)
    declared = declared_pair(declare, ("A", "B"))
    with options(), bar("comparing"):
        first, second = (read_stack(path, declared.of(index)) for index, path in enumerate((a, b)))
        declared.require_used((first.declared, second.declared), (first.stated, second.stated))
        comparison = compare_stacks(first, second)
    if out is not None:
        write_manifest(out, write_comparison(out, comparison), [a, b])
    _print_comparison(comparison)
    give_json(json, comparison_record(comparison))
    if out is not None:
        say(f"Maps: {out}")


def _shown(value: float | None, form: str) -> str:
    """The formatted value; a dash for None and NaN."""
    return "–" if value is None or value != value else format(value, form)


def _shown_percent(difference: float) -> str:
    """Of (A - B) / B, in per cent or as a part of B; a dash for NaN."""
    from ...compare_renders.regress import as_percent

    return "–" if difference != difference else as_percent(difference, "B")


def _print_comparison(comparison: StackComparison) -> None:
    table = data_table(
        f"{comparison.first.source.name} against {comparison.second.source.name}, in {comparison.first.unit}",
        "plane",
        "mean A",
        "mean B",
        "mean difference, %",
        "rms, %",
        "pixels",
        "χ²/pixel",
    )
    for row in comparison.rows:
        table.add_row(
            row.name,
            f"{row.mean_first:.4g}",
            f"{row.mean_second:.4g}",
            _shown_percent(row.relative_mean),
            _shown(100 * row.relative_rms, ".3f"),
            str(row.pixels),
            _shown(row.chi2_per_pixel, ".3f"),
        )
    print_table(table)
    summed = "X, Y, Z" if {*comparison.first.names} <= {"X", "Y", "Z"} else "all wavelengths"
    if comparison.means:
        means = data_table(f"Means over {summed}, (A - B) / B", "part", "difference, %", "± %", "pixels")
        for mean in comparison.means:
            means.add_row(mean.name, _shown_percent(mean.difference), f"{100 * mean.sigma:.3f}", str(mean.pixels))
        print_table(means)
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
        print_table(worst)
    for note in comparison.notes:
        say(f"• {note}")


def verify(
    results: Annotated[
        Path,
        typer.Argument(
            help="A folder of results, a cube, a raw frame, or what regress wrote with --json or --junit.",
            show_default=False,
        ),
    ],
    *,
    json: JsonOption = None,
) -> None:
    """Check that results, and the inputs they were made from, are those of their manifest.

    Exit code 0 unchanged, 1 something changed or is gone, 2 no manifest.
    """
    from ...api import verify as run

    found = run(results)
    for line in found.lines():
        say(line)
    give_json(json, {"sound": found.sound, **asdict(found)})
    if not found.sound:
        raise typer.Exit(1)
    say(f"{results}: {found.outputs} results and {found.inputs} inputs are unchanged.")
