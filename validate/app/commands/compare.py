"""``cbox compare``: two cubes, maps or captures, plane by plane."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import DeclarePairOption, JsonOption
from .console import (
    bar,
    data_table,
    declared_pair,
    give_json,
    options,
    print_table,
    require_folder,
    say,
)

if TYPE_CHECKING:
    from ...compare_renders import StackComparison

__all__ = ["compare"]


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
