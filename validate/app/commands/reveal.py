"""``cbox reveal``: the sealed answer of a synthetic capture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import JsonOption
from .console import (
    data_table,
    errors,
    give_json,
    options,
    print_table,
    say,
)

if TYPE_CHECKING:
    from ...synthetic import Answer, Score

__all__ = ["reveal"]


def reveal(
    folder: Annotated[Path, typer.Argument(help="A capture made with --hide.", show_default=False)],
    diagnosis: Annotated[Path | None, typer.Option(help="File of `cbox diagnose --json`, to be scored.")] = None,
    expected_hash: Annotated[
        str | None,
        typer.Option(
            "--hash",
            help="The hash told when the capture was sealed; another one ends with exit code 1.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Open a sealed answer, and score a diagnosis against it.

    Exit code 1, and nothing is opened, where the seal has another hash than --hash.
    """
    from ...synthetic import open_seal, read_diagnosis, score

    with options("`cbox diagnose --json` writes one."):
        found = None if diagnosis is None else read_diagnosis(diagnosis)
    with options("`cbox capture --hide` makes one."):
        answer = open_seal(folder)
    if expected_hash is not None and expected_hash.strip().lower() != answer.sha256:
        errors.print(
            f"{folder}: the seal has the hash {answer.sha256}, not {expected_hash}: another answer was sealed since",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(1)
    say(f"The seal's hash: {answer.sha256}")
    if expected_hash is None:
        say(
            "Capture and answer are those of this seal. Whether it is the first one is not checked: give --hash, "
            "the hash told when the capture was sealed."
        )
    else:
        say("It is the one told: capture and answer are unchanged since then.")
    if not answer.effects:
        say("No effect was hidden.")
    result = None if found is None else score(answer, found)
    _print_answer(answer, result)
    hidden = [{"effect": name, "parameters": dict(values)} for name, values in answer.effects]
    checked = expected_hash is not None
    give_json(
        json,
        {
            "sha256": answer.sha256,
            "hash_checked": checked,
            "hidden": hidden,
            "score": None if result is None else result.to_dict(),
        },
    )


def _print_answer(answer: Answer, result: Score | None) -> None:
    table = data_table(
        "Hidden", "effect", "parameters", *(() if result is None else ("rank", "selected", "error of each"))
    )
    for index, (name, parameters) in enumerate(answer.effects):
        cells = [
            name,
            ", ".join(f"{k} = {v if isinstance(v, str) else format(v, '.4g')}" for k, v in parameters.items()),
        ]
        if result is not None:
            row = result.effects[index]
            errors = ", ".join(f"{key} {100 * error:+.1f}%" for key, error in row.errors.items())
            cells += [str(row.rank or "–"), "yes" if row.selected else "no", errors or "–"]
        table.add_row(*cells)
    if answer.effects:
        print_table(table)
    if result is not None:
        first, selection = ("right" if sound else "wrong" for sound in (result.first, result.exact))
        say(f"First of the ranking: {first}. Selection: {selection}.")
        if result.falsely_selected:
            say(f"Selected, but not hidden: {', '.join(result.falsely_selected)}")
