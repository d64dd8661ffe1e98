"""``cbox dataset``: make a data set of synthetic pictures with their truths."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import bar, give_json, options, print_result, require_folder, say, warn_unless_compiled

__all__ = ["dataset"]

#: Page of a dry run, in the folder of the data set.
_PREVIEW = "preview.html"


def dataset(
    recipe: Annotated[Path, typer.Argument(help="Recipe of distributions (TOML).", show_default=False)],
    *,
    out: Annotated[
        Path,
        typer.Option(help="Folder of the data set: new, empty, or begun with the same recipe.", show_default=False),
    ],
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Write OUT-preview.html with twenty thumbnails and the distributions only."),
    ] = False,
    processes: Annotated[int, typer.Option(help="Number of processes on this machine.", min=1, max=256)] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers share the pictures.")
    ] = None,
    local_cluster: Annotated[
        int | None, typer.Option(help="Number of workers of a Dask cluster that is started here.", min=1, max=256)
    ] = None,
    json: JsonOption = None,
) -> None:
    """Make a data set: boxes drawn from a recipe, spectral cubes, and the truth about each.

    If you interrupt the command, the same command continues with the pictures that are missing, and writes the same
    files. Pictures that fail a check are kept apart, and the exit code is 1.
    """
    from ...dataset import Workers, create_dataset, preview_recipe

    if sum((processes > 1, scheduler is not None, local_cluster is not None)) > 1:
        raise InputError("--processes, --scheduler, --local-cluster", "several of them", "one of the three")
    require_folder(out.parent)
    warn_unless_compiled()
    if dry_run:
        with bar("drawing boxes") as report:
            preview = preview_recipe(recipe, out.with_name(f"{out.name}-{_PREVIEW}"), report)
        print_result(preview.lines(), [])
        give_json(json, {"page": preview.page, "pictures": preview.pictures, "seconds_each": preview.seconds_each})
        say(f"Preview: {preview.page}")
        return
    with options(scheduler="--scheduler"), bar("rendering pictures") as report:
        run = create_dataset(recipe, out, Workers(processes, scheduler, local_cluster), report)
    print_result(run.lines(), [])
    give_json(json, run.to_dict())
    say(f"Data set: {out}")
    if run.failed:
        raise typer.Exit(1)
