"""The command line: ``cbox``. A user's mistake ends in one message and exit code 2."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from cboxlab.scenes.errors import InputError
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

__all__ = ["app", "main"]

app = typer.Typer(
    help="How far a physically based rendering is from the real thing, where, and why.",
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
)  # fmt: skip
console = Console()
errors = Console(stderr=True)

CaptureFolder = Annotated[Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)]
ModelFile = Annotated[Path | None, typer.Option("--model", help="Model file (TOML); the published box where left out.")]


def main() -> None:
    """Entry point: exit codes 0 fine, 1 the check failed, 2 bad input."""
    try:
        app(standalone_mode=True)
    except InputError as error:
        errors.print(f"[bold red]error:[/] {_escaped(str(error))}", soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted; nothing half-written")
        sys.exit(130)


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


@contextmanager
def _bar(title: str) -> Iterator:
    """A progress bar that takes the part done, 0 to 1."""
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task(title, total=1.0)
        yield lambda part: progress.update(task, completed=part)


def _model(path: Path | None):
    from .model import Model, load_model

    return Model() if path is None else load_model(path)


def _require_compiled() -> None:
    from cboxlab.render import variant

    if not variant.compiled():
        errors.print(variant.HINT)


@app.command()
def validate(
    capture: CaptureFolder,
    model: ModelFile = None,
    out: Annotated[Path, typer.Option(help="Folder for report.html, metrics.json and maps.")] = Path("validation"),
) -> None:
    """The main job: calibrate, render, compare, report."""
    from .pipeline import validate as run
    from .pipeline import write_validation

    _require_compiled()
    chosen = _model(model)
    with _bar("validating") as report:
        result = run(capture, chosen, report)
    write_validation(result, out)
    _summary(result)
    console.print(f"Report: {out / 'report.html'}")


def _summary(result) -> None:
    from .verdict import verdict

    c = result.comparison
    table = Table(title=f"{result.prepared.calibration.capture.folder.name}: measured against rendered")
    table.add_column("surface")
    for band in c.bands:
        table.add_column(f"{band}, %", justify="right")
    table.add_column("ΔE*ab", justify="right")
    table.add_column("χ²/dof", justify="right")
    for name, row in c.by_surface.items():
        table.add_row(name, *(f"{100 * v:+.2f}" for v in row.relative), f"{row.delta_e_ab:.2f}", f"{row.chi2.per_dof:.2f}")
    console.print(table)
    console.print(
        f"χ² per degree of freedom {c.chi2.per_dof:.3f} (interiors {c.chi2_interiors.per_dof:.3f}, edges {c.chi2_edges.per_dof:.3f}); "
        f"mean ΔE*ab {c.delta_e_ab.mean:.2f} (noise alone {c.delta_e_ab_noise.mean:.2f}); "
        f"render/sensor noise {c.render_sigma_over_sensor_sigma:.2f}; lamp × {result.fit.lamp_scale:.4f}; {result.seconds:.0f} s"
    )
    console.print(f"[bold]{verdict(c).headline}[/]")


@app.command()
def calibrate(
    capture: CaptureFolder,
    out: Annotated[Path, typer.Option(help="Folder for calibration.json, plots and patches.csv.")] = Path("calibration-report"),
) -> None:
    """Camera, noise, linearity, filter weights, absolute scale, as far as a capture allows."""
    from cboxlab.calibration.calibrate import calibrate as run
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.write_calibration import write_calibration

    calibration = run(load_capture(capture))
    write_calibration(calibration, out)
    for note in calibration.notes:
        console.print(f"• {_escaped(note)}")
    console.print(f"Calibration: {out / 'calibration.json'}")


@app.command()
def effects(identifier: Annotated[str | None, typer.Argument(help="One effect, in full.")] = None) -> None:
    """The catalogue of physical effects a model may lack."""
    from .effects import catalogue

    known = catalogue()
    if identifier is None:
        table = Table("effect", "acts on", "parameters", "what happens")
        for effect in known.values():
            table.add_row(effect.id, effect.stage, ", ".join(p.name for p in effect.parameters), effect.summary)
        console.print(table)
        return
    if identifier not in known:
        raise InputError("cbox effects", repr(identifier), f"one of {', '.join(known)}")
    effect = known[identifier]
    console.print(f"[bold]{effect.id}[/] (acts on: {effect.stage})\n{effect.summary}\n")
    table = Table("parameter", "unit", "null value", "from", "to", "choices")
    for p in effect.parameters:
        numbers = ("", "", "", "") if p.choices else (p.unit, "–" if p.null is None else f"{p.null:g}", f"{p.low:g}", f"{p.high:g}")
        table.add_row(p.name, *numbers, ", ".join(p.choices))
    console.print(table)
    console.print(f"To confirm or rule out: {effect.confirm}")
    for source in effect.sources:
        console.print(f"Source: {source}")
