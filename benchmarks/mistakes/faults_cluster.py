"""A data set on a Dask cluster whose worker dies or returns late, or whose scheduler ends: the same bits as without.

Run: python benchmarks/mistakes/faults_cluster.py WORK [--boxes 6] [--cases killed,late,restarted]

A reference is made in one process, once. Each case then runs ``cbox dataset --scheduler`` with two workers, each
a process, and disturbs them when the first picture is there:

- killed: one worker is killed (SIGKILL), and nobody starts another one.
- late: one worker stands still (SIGSTOP) until the scheduler has given it up and the command has ended, then returns
  and finishes its task on the finished set.
- restarted: the scheduler and both workers are killed, and started again at the same address.

Every array and attribute of every picture must be that of the reference, and its record but for seconds. Exit code 1
if anything differs. Nothing is left running.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import xarray as xr

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from faults_runs import TIMES
from helpers.scenes.recipes import write_recipe

#: Silence after which the scheduler gives a worker up, s: shorter than Dask's own 300, longer than a busy machine's.
SILENCE_S = 60
#: Most seconds of one run: many times what it takes.
LIMIT_S = 1200
#: Times in the records of pictures.
SECONDS = re.compile(rb'"[a-z_]*seconds[^,}]*')
CBOX = str(Path(sys.executable).with_name("cbox"))


def contents(folder: Path) -> dict[str, str]:
    """By name, digests of all pictures' arrays and attributes, and of all other files but for times."""
    digests = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if path.suffix == ".nc":
            with xr.open_dataset(path) as picture:
                parts = [repr(sorted(picture.attrs.items()))]
                for name, variable in sorted(picture.variables.items()):
                    parts += [str(name), repr(sorted(variable.attrs.items())), str(variable.dtype)]
                    parts.append(hashlib.sha256(variable.values.tobytes()).hexdigest())
            text = "\n".join(parts).encode()
        else:
            text = SECONDS.sub(b"", TIMES.sub(b"", path.read_bytes()))
        digests[str(path.relative_to(folder))] = hashlib.sha256(text).hexdigest()
    return digests


class Cluster:
    """A scheduler and two workers, each a process; their address stays the same when they are started again."""

    def __init__(self, work: Path) -> None:
        self.work, self.processes = work, list[subprocess.Popen]()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"

    def start(self) -> None:
        local = ("--host", "127.0.0.1", "--no-dashboard")
        self._start("scheduler", *local, "--port", str(self.port))
        for _ in range(2):
            options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self.work / "workers"))
            self._start("worker", self.address, *local, *options)

    def _start(self, kind: str, *options: str) -> None:
        environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": f"{SILENCE_S} s"}
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options]
        with (self.work / "cluster.log").open("a") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log, env=environment))

    def end(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        self.processes.clear()


@contextmanager
def cluster_in(work: Path) -> Iterator[Cluster]:
    cluster = Cluster(work)
    cluster.start()
    try:
        yield cluster
    finally:
        cluster.end()


def started(recipe: Path, out: Path, *options: str) -> subprocess.Popen:
    return subprocess.Popen([CBOX, "dataset", str(recipe), "--out", str(out), "--quiet", *options])


def until_first_picture(process: subprocess.Popen, out: Path) -> None:
    while process.poll() is None and not [*out.glob("boxes/*/*.nc")]:
        time.sleep(0.1)


def disturbed(case: str, work: Path, recipe: Path) -> str:
    """What is not as expected after one case, empty if all is."""
    out = work / case
    shutil.rmtree(out, ignore_errors=True)
    with cluster_in(work) as cluster:
        process = started(recipe, out, "--scheduler", cluster.address)
        until_first_picture(process, out)
        if process.poll() is not None:
            return f"exit code {process.returncode} before anything was disturbed"
        worker = cluster.processes[1]
        if case == "killed":
            worker.kill()
        elif case == "late":
            worker.send_signal(signal.SIGSTOP)
        else:
            cluster.end()
            cluster.start()
        try:
            code = process.wait(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return f"no end within {LIMIT_S} s"
        if case == "late":
            worker.send_signal(signal.SIGCONT)
            time.sleep(SILENCE_S)
    if code:
        return f"exit code {code}"
    expected, result = contents(work / "reference"), contents(out)
    changed = sorted(name for name in expected | result if expected.get(name) != result.get(name))
    return f"other files or bits: {changed[:5]}" if changed else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--boxes", type=int, default=6)
    parser.add_argument("--cases", default="killed,late,restarted")
    options = parser.parse_args()
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    recipe = write_recipe(work, ("boxes = 2", f"boxes = {options.boxes}"))
    if started(recipe, work / "reference").wait(timeout=LIMIT_S):
        raise RuntimeError("the reference could not be made")
    faults = 0
    for case in options.cases.split(","):
        begun = time.monotonic()
        fault = disturbed(case, work, recipe)
        faults += bool(fault)
        print(f"{case:10} {time.monotonic() - begun:5.0f} s  {fault or 'the same bits'}", flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
