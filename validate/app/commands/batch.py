"""The command batch: the same command for every capture below a folder, resumable, with one summary."""

from __future__ import annotations

import csv
import shlex
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.progress import Cancelled, Progress

from .arguments import JsonOption
from .console import bar, give_json, require_folder, say

__all__ = ["batch"]

#: Name of a capture's log in its folder of results: what its command printed.
_LOG = "log.txt"


#: The program, as a process of its own; its arguments follow.
_CBOX = "import sys; from cboxlab.validation.app.commands.cli import main; sys.argv[0] = 'cbox'; main()"


class What(StrEnum):
    """The command that each capture is given to."""

    CALIBRATE = "calibrate"
    VALIDATE = "validate"
    DIAGNOSE = "diagnose"


def _of_calibration(found: Mapping[str, Any]) -> dict[str, Any]:
    return {"suspicions": len(found["suspicions"])}


def _of_validation(found: Mapping[str, Any]) -> dict[str, Any]:
    return {"chi2_per_dof": found["chi2_per_dof"], "delta_e_ab": found["delta_e_ab"]["mean"]}


def _of_diagnosis(found: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "chi2_per_dof": found["chi2_per_dof"],
        "final_chi2_per_dof": found["final_chi2_per_dof"],
        "selected": " ".join(found["selected"]) or "none",
    }


#: By command: the file of its results, and what the summary takes from it.
_RESULTS = {
    What.CALIBRATE: ("calibration.json", _of_calibration),
    What.VALIDATE: ("metrics.json", _of_validation),
    What.DIAGNOSE: ("diagnosis.json", _of_diagnosis),
}


def batch(
    folder: Annotated[
        Path,
        typer.Argument(help="A folder; every folder below it with a capture.toml is a capture.", show_default=False),
    ],
    *,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for the results, one folder for each capture, and for summary.csv.", show_default=False
        ),
    ],
    what: Annotated[What, typer.Option(help="The command that each capture is given to.")] = What.DIAGNOSE,
    model: Annotated[Path | None, typer.Option(help="Model or scene file (TOML); default the capture's scene.")] = None,
    jobs: Annotated[int, typer.Option(help="Captures at the same time.", min=1, max=64)] = 1,
    json: JsonOption = None,
) -> None:
    """Calibrate, validate or diagnose many captures, each in a process of its own, with one summary.

    The same command again goes on: a capture whose inputs and results are those of its manifest is not computed again.
    A capture that is refused or fails stops no other one. Exit code 2 if any was refused, 3 if any failed.
    """
    if model is not None and what is What.CALIBRATE:
        raise InputError("--model", "a model with --what calibrate", "a model to validate or diagnose with")
    captures = _captures(folder)
    require_folder(out)
    rows: dict[str, dict[str, Any]] = {}
    try:
        with bar("captures") as report:
            for row in _run_all(folder, captures, out, what, model, jobs, report):
                rows[row["capture"]] = row
                _write_summary(out, [rows[name] for name in captures if name in rows])
    finally:
        if rows:
            say(f"Summary: {out / 'summary.csv'} ({len(rows)} of {len(captures)} captures)")
    ordered = [rows[name] for name in captures]
    _tell(ordered)
    give_json(json, {"captures": ordered})
    worst = max(_EXIT[row["status"]] for row in ordered)
    if worst:
        raise typer.Exit(worst)


_EXIT = {"done": 0, "kept": 0, "refused": 2, "failed": 3}


def _captures(folder: Path) -> list[str]:
    """Captures below a folder, as paths relative to it, in order. Raises InputError for none."""
    found = sorted(path.parent.relative_to(folder).as_posix() for path in folder.rglob("capture.toml"))
    if not found:
        raise InputError(folder, "no capture.toml below it", "a folder with captures")
    return found


def _run_all(
    folder: Path, captures: list[str], out: Path, what: What, model: Path | None, jobs: int, report: Progress
) -> Iterator[dict[str, Any]]:
    """The row of each capture, as they end. Where the run is cancelled, captures not begun are left out."""
    with ThreadPoolExecutor(jobs) as pool:
        waiting: set[Future[dict[str, Any]]] = {
            pool.submit(_run_one, name, folder / name, out / name, what, model) for name in captures
        }
        done = 0
        try:
            while waiting:
                over, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in over:
                    done += 1
                    yield future.result()
                report.part(done / len(captures))
        except (Cancelled, KeyboardInterrupt):
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _run_one(name: str, capture: Path, place: Path, what: What, model: Path | None) -> dict[str, Any]:
    from ...api import is_current

    row: dict[str, Any] = {"capture": name, "status": "kept", "seconds": 0.0, "message": ""}
    with_model = [] if model is None else ["--model", str(model.resolve())]
    command = [what.value, str(capture.resolve()), "--out", str(place.resolve()), *with_model]
    log = place / _LOG
    if not (log.exists() and is_current(place, shlex.join(["cbox", *command]))):
        start = time.monotonic()
        place.mkdir(parents=True, exist_ok=True)
        run = subprocess.run(
            [sys.executable, "-c", _CBOX, *command],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        with replacing(log) as temporary:
            temporary.write_text(run.stdout + run.stderr, encoding="utf-8")
        row["seconds"] = round(time.monotonic() - start, 1)
        row["status"] = {0: "done", 2: "refused"}.get(run.returncode, "failed")
        if run.returncode:
            said = [line for line in run.stderr.splitlines() if line.startswith(("error: ", "fault: "))]
            row["message"] = said[0].partition(": ")[2] if said else f"ended with {run.returncode}"
            return row
    from cboxlab.utils.input_files import read_json

    file, taken = _RESULTS[what]
    return row | taken(read_json(place / file, "results of cbox"))


def _write_summary(out: Path, rows: list[dict[str, Any]]) -> None:
    """summary.csv, a row for each capture that is over; complete or not at all."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (
        replacing(out / "summary.csv") as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def _tell(rows: list[dict[str, Any]]) -> None:
    """How many ended how, and each that was refused or failed."""
    counts = Counter(row["status"] for row in rows)
    say(", ".join(f"{counts[status]} {status}" for status in _EXIT if counts[status]))
    for row in rows:
        if _EXIT[row["status"]]:
            say(f"• {row['capture']}: {row['status']}: {row['message']}")
