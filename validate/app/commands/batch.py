"""``cbox batch``: the same command for every capture below a folder, with one summary."""

from __future__ import annotations

import csv
import shlex
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import LIST_OF_FAULTS
from cboxlab.utils.files import replacing
from cboxlab.utils.progress import Cancelled, Progress

from .arguments import JsonOption
from .console import bar, give_json, options, require_folder, say

__all__ = ["batch"]

#: File in a capture's folder of results with the output of its command.
_LOG = "log.txt"


#: Program of a process that runs one command; its arguments follow.
_CBOX = "import sys; from cboxlab.validation.app.commands.cli import main; sys.argv[0] = 'cbox'; main()"


class What(StrEnum):
    """Command that is run for each capture."""

    CALIBRATE = "calibrate"
    VALIDATE = "validate"
    DIAGNOSE = "diagnose"


def _of_calibration(record: Mapping[str, Any]) -> dict[str, Any]:
    return {"suspicions": len(record["suspicions"])}


def _of_validation(record: Mapping[str, Any]) -> dict[str, Any]:
    return {"chi2_per_dof": record["chi2_per_dof"], "delta_e_ab": record["delta_e_ab"]["mean"]}


def _of_diagnosis(record: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "chi2_per_dof": record["chi2_per_dof"],
        "final_chi2_per_dof": record["final_chi2_per_dof"],
        "selected": " ".join(record["selected"]) or "none",
    }


#: By command, the file of its results and the function of its columns in the summary.
_RESULTS = {
    What.CALIBRATE: ("calibration.json", _of_calibration),
    What.VALIDATE: ("metrics.json", _of_validation),
    What.DIAGNOSE: ("diagnosis.json", _of_diagnosis),
}


def batch(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder of captures. Every folder below it with a capture.toml is a capture.", show_default=False
        ),
    ],
    *,
    out: Annotated[
        Path,
        typer.Option(help="Folder for summary.csv and the results, one folder for each capture.", show_default=False),
    ],
    what: Annotated[What, typer.Option(help="Command to run for each capture.")] = What.DIAGNOSE,
    model: Annotated[
        Path | None, typer.Option(help="Model or scene file (TOML). The default is the scene that each capture states.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Number of captures to compute at the same time.", min=1, max=64)] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers share the captures.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Calibrate, validate or diagnose many captures, and write one summary.

    Each capture runs in a separate process, here or on the workers of a Dask scheduler, which need the same paths. If
    you repeat the command, captures with unchanged inputs and results are not computed again. A capture that is refused
    or fails does not stop the others. The exit code is 2 if any capture was refused and 3 if any failed.
    """
    if model is not None and what is What.CALIBRATE:
        raise InputError("--model", "a model with --what calibrate", "--what validate or --what diagnose")
    if scheduler is not None and jobs > 1:
        raise InputError("--jobs, --scheduler", "both of them", "one of the two")
    captures = _captures(folder)
    require_folder(out)
    tasks = [
        CaptureTask(name, (folder / name).resolve(), (out / name).resolve(), what, model and model.resolve())
        for name in captures
    ]
    rows: dict[str, dict[str, Any]] = {}
    try:
        with options(scheduler="--scheduler"), bar("captures") as report:
            run = _run_here(tasks, jobs, report) if scheduler is None else _run_there(tasks, scheduler, report)
            for row in run:
                rows[row["capture"]] = row
                _write_summary(out, [rows[name] for name in captures if name in rows])
    finally:
        if rows:
            say(f"Summary of {len(rows)} of {len(captures)} captures: {out / 'summary.csv'}")
    ordered = [rows[name] for name in captures]
    _print_summary(ordered)
    give_json(json, {"captures": ordered})
    worst = max(_EXIT[row["status"]] for row in ordered)
    if worst:
        raise typer.Exit(worst)


#: Exit code of each status of a capture.
_EXIT = {"done": 0, "kept": 0, "refused": 2, "failed": 3}


def _captures(folder: Path) -> list[str]:
    """Sorted paths of captures below a folder, relative to it; InputError if there is none."""
    names = sorted(path.parent.relative_to(folder).as_posix() for path in folder.rglob("capture.toml"))
    if not names:
        raise InputError(folder, "no capture.toml below it", "a folder with captures")
    return names


@dataclass(frozen=True)
class CaptureTask:
    """One capture and its command, for a worker that shares the file system."""

    #: Path of the capture below the folder of captures.
    name: str
    #: Absolute path of the capture.
    capture: Path
    #: Absolute path of the folder of its results.
    results: Path
    #: The command.
    what: What
    #: Absolute path of a model or scene file; None for the scene that the capture states.
    model: Path | None


def _run_there(tasks: list[CaptureTask], scheduler: str, report: Progress) -> Iterator[dict[str, Any]]:
    """Row of each capture, as workers of a Dask scheduler complete them."""
    from ...dataset import on_scheduler

    rows: list[dict[str, Any]] = []
    for row in on_scheduler(tasks, scheduler, lambda: report.part(len(rows) / len(tasks)), run_capture):
        rows.append(row)
        yield row


def _run_here(tasks: list[CaptureTask], jobs: int, report: Progress) -> Iterator[dict[str, Any]]:
    """Row of each capture, in the order of their ends, until the run is cancelled."""
    with ThreadPoolExecutor(jobs) as pool:
        waiting: set[Future[dict[str, Any]]] = {pool.submit(run_capture, task) for task in tasks}
        done = 0
        try:
            while waiting:
                over, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in over:
                    done += 1
                    yield future.result()
                report.part(done / len(tasks))
        except (Cancelled, KeyboardInterrupt):
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def run_capture(task: CaptureTask) -> dict[str, Any]:
    """Row of one capture; its command runs unless its results are current.

    Parameters
    ----------
    task
        The capture and its command.

    Returns
    -------
    dict
        Columns of the summary.
    """
    from ...api import is_current

    row: dict[str, Any] = {"capture": task.name, "status": "kept", "seconds": 0.0, "message": ""}
    with_model = [] if task.model is None else ["--model", str(task.model)]
    results = task.results
    command = [task.what.value, str(task.capture), "--out", str(results), *with_model]
    log = results / _LOG
    if not (log.exists() and is_current(results, shlex.join(["cbox", *command]))):
        start = time.monotonic()
        results.mkdir(parents=True, exist_ok=True)
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
            row["message"] = _message(run.stderr) or f"exit code {run.returncode}"
            return row
    from cboxlab.utils.input_files import read_json

    file, columns = _RESULTS[task.what]
    return row | columns(read_json(results / file, "results of cbox"))


def _message(standard_error: str) -> str:
    """First message of a command, with the first fault of a list; empty for none."""
    lines = iter(standard_error.splitlines())
    message = next((line for line in lines if line.startswith(("error: ", "fault: "))), "").partition(": ")[2]
    if message.endswith(LIST_OF_FAULTS):
        return f"{message.removesuffix(LIST_OF_FAULTS)}The first is: {next(lines, '').strip()}"
    return message


def _write_summary(out: Path, rows: list[dict[str, Any]]) -> None:
    """Write summary.csv, with a row for each finished capture; completely or not at all."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (
        replacing(out / "summary.csv") as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def _print_summary(rows: list[dict[str, Any]]) -> None:
    """Print the number of captures by status, and each that was refused or failed."""
    counts = Counter(row["status"] for row in rows)
    say(", ".join(f"{counts[status]} {status}" for status in _EXIT if counts[status]))
    for row in rows:
        if _EXIT[row["status"]]:
            say(f"• {row['capture']}: {row['status']}: {row['message']}")
