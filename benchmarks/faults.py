"""Commands that are killed, run in pairs, meet a full disk, a closed pipe or Ctrl-C: what is left, and what is said.

Run: python benchmarks/faults.py WORK [--moments 20] [--pairs 5] [--commands calibrate,render]

Each case runs ``cbox`` on the smallest capture, in folders below WORK. Every case is one line of WORK/faults.jsonl; a
later run skips those. Printed at the end: cases and failures by kind and command.

- kill: SIGKILL to the whole process group at a random moment of the command. What stands under a final name must be
  that of an undisturbed run, to the byte; the same command again must end well and leave the same files and no others.
- pair: two at once into one folder and one cache. At least one must succeed, the other may refuse an existing folder.
- full: no file may be longer than some bytes (RLIMIT_FSIZE, its signal ignored, as on a full disk): exit code 2.
- pipe: standard output closed after one line. interrupt: Ctrl-C at a random moment, exit code 130.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

SMALL = ("--size", "16")
COMMANDS = {
    "capture": ("capture", "cornell-box", "--out", "out", *SMALL, "--seed", "1", "--noise", "5%"),
    "render": (
        "render",
        "cornell-box",
        "--out",
        "out/cube.nc",
        *SMALL,
        "--wavelengths",
        "500,600",
        "--noise",
        "0.3%",
    ),
    "simulate": ("simulate", "../../input/cube.nc", "--out", "out/frame.tif", "--seed", "1"),
    "photograph": ("simulate", "../../input/cube.nc", "--out", "out/folder", "--seed", "1"),
    "export": ("export", "cornell-box", "--to", "out/export", *SMALL),
    "calibrate": ("calibrate", "../../input/capture", "--out", "out"),
    "validate": ("validate", "../../input/capture", "--out", "out"),
    "diagnose": ("diagnose", "../../input/capture", "--out", "out", "--json", "out/found.json"),
    "batch": ("batch", "../../input", "--out", "out", "--what", "validate"),
}
#: Dates and seconds of computation, which any two runs have different.
TIMES = re.compile(rb"\d{4}-\d\d-\d\d[ T][0-9:.+]+|\b\d+(\.\d+)? s\b|\"seconds[^,}]*")


def start(
    place: Path, command: tuple[str, ...], prepare: Callable[[], None] | None = None
) -> subprocess.Popen:
    """One ``cbox`` in ``place``, with a cache of its own there."""
    place.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "XDG_CACHE_HOME": str(place / "cache"), "OPENBLAS_NUM_THREADS": "1"}
    program = [str(Path(sys.executable).with_name("cbox")), *command]
    return subprocess.Popen(
        program, cwd=place, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=prepare,
    )  # fmt: skip


def ended(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and what was said on standard error."""
    _, said = process.communicate(timeout=600)
    return process.returncode, said


def files(place: Path) -> dict[str, bytes]:
    """Contents of all results by name."""
    out = place / "out"
    paths = [path for path in sorted(out.rglob("*")) if path.is_file()]
    return {str(p.relative_to(out)): TIMES.sub(b"", p.read_bytes()) for p in paths}


def unfinished(name: str) -> bool:
    return "-unfinished-" in name or name.endswith(".passes")


def unlike(found: dict[str, bytes], whole: dict[str, bytes], steady: set[str]) -> list[str]:
    """Names that an undisturbed run has not, or whose content is another."""
    return [
        name
        for name, content in found.items()
        if name not in whole or (name in steady and whole[name] != content)
    ]


class Undisturbed:
    """What a command leaves when nothing disturbs it, by two runs."""

    def __init__(self, work: Path, command: tuple[str, ...], name: str) -> None:
        runs = []
        self.seconds = 0.0
        for number in (1, 2):
            place = work / name / f"undisturbed-{number}"
            shutil.rmtree(place, ignore_errors=True)
            begun = time.monotonic()
            code, said = ended(start(place, command))
            self.seconds = time.monotonic() - begun
            if code:
                raise RuntimeError(f"{name}: {said}")
            runs.append(files(place))
        self.whole = runs[0]
        self.steady = {name for name, content in self.whole.items() if runs[1].get(name) == content}

    def fault_of_rerun(self, place: Path, command: tuple[str, ...]) -> str:
        """Run again in ``place``: what is not as in an undisturbed run, empty if all is."""
        code, said = ended(start(place, command))
        there = files(place)
        if code and not (code == 2 and "exists already" in said):
            return f"rerun {code}: {said.strip()[-300:]}"
        if left := [name for name in there if unfinished(name)]:
            return f"left: {left}"
        if set(there) != set(self.whole):
            return f"other files: {sorted(set(there) ^ set(self.whole))[:5]}"
        changed = unlike(there, self.whole, self.steady)
        return f"other bits: {changed}" if changed else ""


def kill(place: Path, command: tuple[str, ...], plain: Undisturbed, moment: float) -> str:
    process = start(place, command)
    time.sleep(moment * plain.seconds)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    there = {n: c for n, c in files(place).items() if not any(unfinished(part) for part in Path(n).parts)}
    if half := unlike(there, plain.whole, plain.steady):
        return f"half-written: {half}"
    return plain.fault_of_rerun(place, command)


def pair(place: Path, command: tuple[str, ...], plain: Undisturbed, moment: float) -> str:
    both = [start(place, command)]
    time.sleep(moment * 0.5)
    both.append(start(place, command))
    ends = [ended(one) for one in both]
    bad = [said for code, said in ends if code and not (code == 2 and "exists already" in said)]
    if bad or all(code for code, _ in ends):
        return f"{[code for code, _ in ends]}: {(bad or [''])[0].strip()[-300:]}"
    there = files(place)
    if changed := unlike(there, plain.whole, plain.steady):
        return f"other bits: {changed}"
    return ""


def full(place: Path, command: tuple[str, ...], plain: Undisturbed, moment: float) -> str:
    """Files may hold a share of the largest result."""
    most = int(moment * 0.9 * max(len(content) for content in plain.whole.values()))

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    code, said = ended(start(place, command, limit))
    one_by_one = command[0] == "batch"  # which refuses captures one by one, in its summary
    if code != 2 or "Traceback" in said or (said.count("error: ") != 1 and not one_by_one):
        return f"exit code {code}: {said.strip()[-300:]}"
    there = files(place)
    if half := unlike(there, plain.whole, plain.steady):
        return f"half-written: {half}"
    return plain.fault_of_rerun(place, command)


def pipe(place: Path, command: tuple[str, ...], plain: Undisturbed, moment: float) -> str:
    process = start(place, command)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    said = process.stderr.read()
    code = process.wait(timeout=600)
    there = files(place)
    if code not in (0, -signal.SIGPIPE) or "Traceback" in said or "Exception" in said:
        return f"exit code {code}: {said.strip()[-300:]}"
    if set(there) != set(plain.whole):
        return f"other files: {sorted(set(there) ^ set(plain.whole))[:5]}"
    return ""


def interrupt(place: Path, command: tuple[str, ...], plain: Undisturbed, moment: float) -> str:
    process = start(place, command, lambda: signal.signal(signal.SIGINT, signal.default_int_handler) and None)
    time.sleep(moment * plain.seconds)
    process.send_signal(signal.SIGINT)
    code, said = ended(process)
    if code not in (0, 130, -signal.SIGINT) or (code != -signal.SIGINT and "Traceback" in said):
        return f"exit code {code}: {said.strip()[-300:]}"
    if left := [n for n in files(place) if "-unfinished-" in n]:
        return f"left: {left}"
    return plain.fault_of_rerun(place, command)


KINDS = {"kill": kill, "pair": pair, "full": full, "pipe": pipe, "interrupt": interrupt}


def prepare(work: Path) -> None:
    """A capture of 16 x 16 px and a cube, which the commands read."""
    for name, command in (
        ("capture", ("capture", "cornell-box", "--out", "capture", *SMALL, "--seed", "7", "--noise", "5%")),
        (
            "cube.nc",
            (
                "render",
                "cornell-box",
                "--out",
                "cube.nc",
                *SMALL,
                "--wavelengths",
                "400:700:50",
                "--noise",
                "5%",
            ),
        ),
    ):
        if not (work / "input" / name).exists():
            code, said = ended(start(work / "input", command))
            if code:
                raise RuntimeError(said)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", type=Path)
    parser.add_argument("--moments", type=int, default=20, help="kills per command")
    parser.add_argument("--pairs", type=int, default=5, help="cases of each other kind per command")
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    work = given.work.resolve()
    prepare(work)
    record = work / "faults.jsonl"
    lines = record.read_text(encoding="utf-8").splitlines() if record.exists() else []
    done = {(c["command"], c["kind"], c["number"]): c["fault"] for c in map(json.loads, lines)}
    for name in given.commands.split(","):
        command, plain = COMMANDS[name], None
        for kind in given.kinds.split(","):
            for number in range({"kill": given.moments, "pipe": 1}.get(kind, given.pairs)):
                if (name, kind, number) in done:
                    continue
                plain = plain or Undisturbed(work, command, name)
                place = work / name / kind
                shutil.rmtree(place, ignore_errors=True)
                moment = random.Random(f"{given.seed} {name} {kind} {number}").random()
                fault = KINDS[kind](place, command, plain, moment)
                done[name, kind, number] = fault
                case = {"command": name, "kind": kind, "number": number, "moment": moment, "fault": fault}
                with record.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(case) + "\n")
                if fault:
                    print(f"{name} {kind} {number} at {moment:.2f}: {fault}", flush=True)
        if plain:
            print(
                f"{name}: {plain.seconds:.1f} s, other bits at each run: {sorted(set(plain.whole) - plain.steady)}"
            )
    counts, failed = (
        Counter((n, k) for n, k, _ in done),
        Counter((n, k) for (n, k, _), f in done.items() if f),
    )
    for (name, kind), count in sorted(counts.items()):
        print(f"{name:12} {kind:10} {count:4} cases, {failed[name, kind]} failures")


if __name__ == "__main__":
    main()
