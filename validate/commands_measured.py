"""Commands on captures: demo, validate, calibrate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import bar, console, data_table, require_compiled, require_folder, say

if TYPE_CHECKING:
    from cboxlab.calibration.calibrate import Calibration

    from .pipeline import Validation
    from .stacks import StackComparison

__all__ = ["calibrate", "compare", "demo", "print_validation", "validate"]

CaptureFolder = Annotated[
    Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)
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
    out: Annotated[Path, typer.Option(help="Folder for report.html, metrics.json and maps.")] = Path("validation"),
) -> None:
    """The main job: calibrate, render, compare, report."""
    from .model import Model, load_model
    from .pipeline import validate as run
    from .pipeline import write_validation

    require_folder(out)
    chosen = Model() if model is None else load_model(model)
    require_compiled()
    with bar("validating") as report:
        result = run(capture, chosen, report)
    write_validation(result, out)
    print_validation(result)
    say(f"Report: {out / 'report.html'}")


def print_validation(result: Validation) -> None:
    """The table by surface, the headline figures and the verdict."""
    from .verdict import verdict

    c = result.comparison
    table = data_table(
        f"{result.prepared.calibration.capture.folder.name}: (measured − rendered) / rendered, interiors, %",
        "surface", *c.bands, "ΔE*ab", "χ²/dof",
    )  # fmt: skip
    for name, row in c.by_surface.items():
        table.add_row(
            name, *(f"{100 * v:+.2f}" for v in row.relative), f"{row.delta_e_ab:.2f}", f"{row.chi2.per_dof:.2f}"
        )
    console.print(table)
    say(
        f"χ² per degree of freedom {c.chi2.per_dof:.3f} (interiors {c.chi2_interiors.per_dof:.3f}, edges "
        f"{c.chi2_edges.per_dof:.3f}); mean ΔE*ab {c.delta_e_ab.mean:.2f} (noise alone "
        f"{c.delta_e_ab_noise.mean:.2f}); render/sensor noise {c.render_sigma_over_sensor_sigma:.2f}; "
        f"lamp × {result.fit.lamp_scale:.4f}; {result.seconds:.0f} s"
    )
    console.print(f"[bold]{verdict(c).headline}[/]")


def calibrate(
    capture: CaptureFolder,
    out: Annotated[Path, typer.Option(help="Folder for calibration.json, plots and patches.csv.")] = Path(
        "calibration-report"
    ),
) -> None:
    """Camera, noise, linearity, filter weights, absolute scale, as far as a capture allows."""
    from cboxlab.calibration.calibrate import calibrate as run
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.write_calibration import write_calibration

    require_folder(out)
    with bar("calibrating"):
        calibration = run(load_capture(capture))
    write_calibration(calibration, out)
    _print_calibration(calibration)
    for note in calibration.notes:
        say(f"• {note}")
    say(f"Calibration: {out / 'calibration.json'}")


def _print_calibration(calibration: Calibration) -> None:
    from .calibration_rows import calibration_rows, patch_rows

    table = data_table(
        calibration.capture.manifest.name or calibration.capture.folder.name, "", "value", "± 1 σ", "unit"
    )
    for row in calibration_rows(calibration):
        table.add_row(*row)
    console.print(table)
    if calibration.patches is not None:
        colours = data_table("Patches", "label", "X", "Y", "Z", "σ(Y)")
        for row in patch_rows(calibration.patches):
            colours.add_row(*row)
        console.print(colours)


def compare(
    a: Annotated[Path, typer.Argument(help="Cube (.nc, .exr, .hdr), map (.exr) or capture folder.", show_default=False)],
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


def _print_comparison(comparison: StackComparison) -> None:
    table = data_table(
        f"{comparison.first.source.name} against {comparison.second.source.name}, in {comparison.first.unit}",
        "plane", "mean A", "mean B", "mean difference, %", "rms, %", "pixels", "χ²/pixel",
    )  # fmt: skip
    for row in comparison.rows:
        table.add_row(
            row.name, f"{row.mean_first:.4g}", f"{row.mean_second:.4g}", f"{100 * row.relative_mean:+.3f}",
            f"{100 * row.relative_rms:.3f}", str(row.pixels),
            "–" if row.chi2_per_pixel is None else f"{row.chi2_per_pixel:.3f}",
        )  # fmt: skip
    console.print(table)
    worst = data_table("Worst pixels", "plane", "x", "y", "A", "B", comparison.worst_measure)
    for pixel in comparison.worst:
        worst.add_row(
            pixel.plane, str(pixel.x), str(pixel.y), f"{pixel.first:.4g}", f"{pixel.second:.4g}", f"{pixel.size:+.4g}"
        )
    console.print(worst)
    for note in comparison.notes:
        say(f"• {note}")
