"""``cbox reveal``: open the sealed answer of a synthetic capture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import JsonOption
from .console import (
    errors,
    give_json,
    options,
    print_result,
)

__all__ = ["reveal"]


def reveal(
    folder: Annotated[Path, typer.Argument(help="Capture that `cbox capture --hide` wrote.", show_default=False)],
    diagnosis: Annotated[
        Path | None, typer.Option(help="File that `cbox diagnose --json` wrote, to compare it with the answer.")
    ] = None,
    expected_hash: Annotated[
        str | None,
        typer.Option(
            "--hash",
            help="Hash that `cbox capture --hide` printed. The exit code is 1 if the seal has another hash.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Open the sealed answer of a capture, and compare a diagnosis with it.

    If the seal has another hash than --hash, the answer stays closed and the exit code is 1.
    """
    from ...synthetic import open_seal, read_diagnosis, score

    with options("`cbox diagnose --json` writes such a file."):
        record = None if diagnosis is None else read_diagnosis(diagnosis)
    with options("`cbox capture --hide` writes such a capture."):
        answer = open_seal(folder)
    if expected_hash is not None and expected_hash.strip().lower() != answer.sha256:
        errors.print(
            f"{folder}: the seal has hash {answer.sha256}, not {expected_hash}. Another answer was sealed later.",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(1)
    if expected_hash is None:
        check = "You gave no --hash, so the program did not compare it with the one that `cbox capture --hide` printed."
    else:
        check = "It equals the hash you gave: capture and answer are unchanged."
    result = None if record is None else score(answer, record)
    lines = [f"The seal has hash {answer.sha256}. {check}", *answer.lines()]
    tables = answer.tables()
    if result is not None:
        lines += result.lines()
        tables += result.tables()
    print_result(lines, tables)
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
