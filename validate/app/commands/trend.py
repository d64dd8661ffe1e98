"""``cbox trend``: several results side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import give_json, require_file, say

__all__ = ["trend"]

#: Fewest results with a trend.
_FEWEST = 2


def trend(
    results: Annotated[
        list[Path],
        typer.Argument(
            help="Folders that `cbox validate` or `cbox diagnose` wrote, in the order of the page.", show_default=False
        ),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Page to write, or a folder for trend.html.")] = Path("trend.html"),
    json: JsonOption = None,
) -> None:
    """Compare several results: every figure and fitted number, side by side and as a curve.

    Use it for a model before and after a change, for several cameras, or for a series over days.
    """
    from ...report import read_trend_result, trend_finding, trend_record, trend_rows, write_trend

    if len(results) < _FEWEST:
        raise InputError("RESULTS", f"{len(results)} folder", f"at least {_FEWEST} folders of results")
    out = out if out.suffix else out / "trend.html"
    require_file(out)
    read = [read_trend_result(folder) for folder in results]
    write_trend(out, read)
    say(trend_finding(read))
    for name, *texts in trend_rows(read):
        say(f"{name}: {', '.join(texts)}")
    give_json(json, trend_record(read))
    say(f"Page: {out}")
