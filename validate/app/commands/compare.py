"""``cbox compare``: compare two cubes, maps or captures, plane by plane."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import DeclareComparedOption, JsonOption
from .console import (
    bar,
    declared_pair,
    give_json,
    options,
    print_result,
    require_folder,
    say,
)

__all__ = ["compare"]


def compare(
    a: Annotated[
        Path,
        typer.Argument(
            help="A: cube or picture (.nc, .exr, .hdr, .tif, .npy), map (.exr) or capture folder.", show_default=False
        ),
    ],
    b: Annotated[Path, typer.Argument(help="B: the reference, of the same kind.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for maps and comparison.json.")] = None,
    declare: DeclareComparedOption = None,
    json: JsonOption = None,
) -> None:
    """Compare two cubes, maps or captures: tables and maps of (A − B) / B."""
    from ...api import write_manifest
    from ...compare_renders import compare_stacks, comparison_record, read_compared, write_comparison

    if out is not None:
        require_folder(out)
    declared = declared_pair(declare, ("A", "B"))
    with options(), bar("comparing"):
        first, second = read_compared((a, b), declared)
        declared.require_used((first.declared, second.declared), (first.file_statements, second.file_statements))
        comparison = compare_stacks(first, second)
    if out is not None:
        write_manifest(out, write_comparison(out, comparison), [a, b])
    print_result(comparison.lines(), comparison.tables())
    give_json(json, comparison_record(comparison))
    if out is not None:
        say(f"Maps: {out}")
