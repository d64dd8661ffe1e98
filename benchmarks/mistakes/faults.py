"""Commands that are killed, run in pairs, meet a full disk, a closed pipe or Ctrl-C: what is left, and what is said.

Run: python benchmarks/mistakes/faults.py WORK [--moments 20] [--pairs 5] [--commands calibrate,render]

Each case runs ``cbox`` on the smallest capture, in folders below WORK. Every case is one line of WORK/faults.jsonl; a
later run skips those. Printed at the end: cases and failures by kind and command.

- kill: SIGKILL to the whole process group, at a random moment of the command for even numbers, while it writes for odd
  ones. What stands under a final name must be that of an undisturbed run, to the byte, or what lay there before; the
  same command again must end well and leave the same files and no others.
- stop: one run is stopped (SIGSTOP) at 20 random moments, every other of them while it writes, and what SIGKILL would
  leave then is copied. Of each copy as of a kill; copies of the same content are run again once.
- pair: two at once into one folder and one cache. At least one must succeed, the other may refuse an existing folder.
- full: no file may be longer than some bytes (RLIMIT_FSIZE, its signal ignored): exit code 2.
- disk, cache: a file system that is too small for the results (exit code 2) or for the cache (all results, or exit
  code 2). They need the right to mount, and are left out without it.
- clock: each look at the date is years off. stall: opening, writing and renaming take long. Same files, same bits.
  They need a C compiler.
- home: another user than root, with a home and a cache that cannot be written: same files, same bits. results: one who
  may not write where the results belong: exit code 2, nothing written. They need root and `setpriv`.
- pipe: standard output closed after one line. interrupt: Ctrl-C at a random moment, exit code 130.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import faults_runs
from faults_commands import COMMANDS, MADE, Command
from faults_forked import import_all
from faults_runs import TAKEN, Undisturbed, ended, files, finished, start
from faults_surroundings import SURROUNDINGS

#: Moments of one run of "stop".
STOPS = 20


def kill(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    first, last = (plain.writing[0] - 0.1, plain.writing[-1] + 0.1) if number % 2 else (0.0, plain.seconds)
    process = start(folder, command)
    time.sleep(max(first + moment * (last - first), 0))
    if process.poll() is None:
        with suppress(ProcessLookupError):  # it ended by itself
            (os.killpg if _in_own_group(process.pid) else os.kill)(process.pid, signal.SIGKILL)
    process.communicate()
    if half := plain.unlike(finished(folder)):
        return f"half-written: {half}"
    return plain.fault_of_rerun(folder, command)


def stop(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    generator = random.Random(moment)
    span = plain.writing[-1] - plain.writing[0] + 0.2
    moments = [generator.random() * plain.seconds for _ in range(STOPS // 2)]
    moments += [plain.writing[0] - 0.1 + generator.random() * span for _ in range(STOPS - STOPS // 2)]
    copies = []
    process, begun, still = start(folder, command), time.monotonic(), 0.0
    for moment_expected in sorted(moments):
        time.sleep(max(begun + still + moment_expected - time.monotonic(), 0))
        if process.poll() is not None or not _in_own_group(process.pid):
            continue
        stopped = time.monotonic()
        os.killpg(process.pid, signal.SIGSTOP)
        copies.append(folder.with_name(f"stop-{len(copies)}"))
        shutil.rmtree(copies[-1], ignore_errors=True)
        shutil.copytree(folder, copies[-1], symlinks=True)
        os.killpg(process.pid, signal.SIGCONT)
        still += time.monotonic() - stopped
    ended(process)
    plain.moments = len(copies)
    faults = [_fault_of_copy(copy, command, plain) for copy in copies]
    return next(filter(None, faults), "")


def _in_own_group(pid: int) -> bool:
    """Not in the first moments of a fork."""
    return os.getpgid(pid) == pid


def _fault_of_copy(folder: Path, command: Command, plain: Undisturbed) -> str:
    if half := plain.unlike(finished(folder)):
        return f"half-written: {half}"
    members = set()
    for path in folder.rglob("*"):
        name, _, temporary = str(path.relative_to(folder)).partition("-unfinished-")
        members.add((name, path.read_bytes() if path.is_file() and not temporary else b""))
    state = hashlib.sha256(repr(sorted(members)).encode())
    if state.hexdigest() not in plain.sound:
        if fault := plain.fault_of_rerun(folder, command):
            return fault
        plain.sound.add(state.hexdigest())
    shutil.rmtree(folder)
    return ""


def pair(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    both = [start(folder, command)]
    time.sleep(moment * min(0.5, plain.seconds))
    both.append(start(folder, replace(command, laid=())))
    ends = [ended(process) for process in both]
    bad = [said for code, said in ends if code and not (code == 2 and any(phrase in said for phrase in TAKEN))]
    if bad or all(code for code, _ in ends):
        return f"{[code for code, _ in ends]}: {(bad or [''])[0].strip()[-300:]}"
    if command.arguments[0] == "add" and not any(code for code, _ in ends):
        times = (folder / "out" / "model.toml").read_text(encoding="utf-8").count(command.arguments[2])
        return "" if times == 2 else f"{times} of two effects"
    if changed := plain.unlike(files(folder)):
        return f"other bits: {changed}"
    return ""


def full(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    """Files may hold a share of the largest result."""
    most = int(moment * 0.9 * max(len(c) for n, c in plain.whole.items() if plain.before.get(n) != c))

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    code, said = ended(start(folder, command, limit))
    return _refused(command, code, said, (2,)) or _none_half(folder, plain) or plain.fault_of_rerun(folder, command)


def disk(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    with small_file_system(folder, int(moment * sum(plain.kilobytes.values()))):
        try:
            code, said = ended(start(folder, command))
        except OSError:  # no room for what is laid
            return ""
        fault = _refused(command, code, said, (0, 2)) or _none_half(folder, plain)
        subprocess.run(["mount", "-o", "remount,size=1g", str(folder)], check=True)
        return fault or plain.fault_of_rerun(folder, command)


def cache(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    with small_file_system(folder / "cache", int(moment * plain.kilobytes["cache"])):
        code, said = ended(start(folder, command))
        fault = _refused(command, code, said, (0, 2)) or _none_half(folder, plain)
        subprocess.run(["mount", "-o", "remount,size=1g", str(folder / "cache")], check=True)
        return fault or plain.fault_of_rerun(folder, command)


@contextmanager
def small_file_system(folder: Path, kilobytes: int) -> Iterator[None]:
    folder.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={max(kilobytes, 4)}k", "tmpfs", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def _refused(command: Command, code: int, said: str, codes: tuple[int, ...]) -> str:
    """What is wrong with the end of a command that could not write all; empty if nothing is."""
    is_stated = said.count("error: ") == 1 or command.arguments[0] in ("batch", "-c")  # batch states it in its summary
    sound = code in codes and (code == 0 or is_stated) and ("Traceback" not in said or command.arguments[0] == "-c")
    if command.arguments[0] == "-c":  # a program of the user's own, whose errors are its own
        sound = code == 0 or "OSError" in said or "InputError" in said
    return "" if sound else f"exit code {code}: {said.strip()[-300:]}"


def _none_half(folder: Path, plain: Undisturbed) -> str:
    half = plain.unlike({n: c for n, c in files(folder).items() if not n.endswith(".passes")})
    return f"half-written: {half}" if half else ""


def pipe(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    process = start(folder, command)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    said = process.stderr.read()
    code = process.wait(timeout=900)
    contents = files(folder)
    if code not in (0, -signal.SIGPIPE) or "Traceback" in said or "Exception" in said:
        return f"exit code {code}: {said.strip()[-300:]}"
    if set(contents) != set(plain.whole):
        return f"other files: {sorted(set(contents) ^ set(plain.whole))[:5]}"
    return ""


def interrupt(folder: Path, command: Command, plain: Undisturbed, moment: float, number: int) -> str:
    process = start(folder, command, lambda: signal.signal(signal.SIGINT, signal.default_int_handler) and None)
    time.sleep(moment * plain.seconds)
    process.send_signal(signal.SIGINT)
    code, said = ended(process)
    plainly = code == -signal.SIGINT or command.arguments[0] == "-c"
    if code not in (0, 130, -signal.SIGINT) or (not plainly and "Traceback" in said):
        return f"exit code {code}: {said.strip()[-300:]}"
    if unfinished_files := [n for n in files(folder) if "-unfinished-" in n]:
        return f"left: {unfinished_files}"
    return plain.fault_of_rerun(folder, command)


KINDS = {
    "kill": kill,
    "stop": stop,
    "pair": pair,
    "full": full,
    "disk": disk,
    "cache": cache,
    "pipe": pipe,
    "interrupt": interrupt,
    **SURROUNDINGS,
}
#: Kinds that only root can try.
AS_ROOT = {"disk", "cache", "home", "results"}


def prepare(work: Path) -> None:
    """What the commands read, from a capture of 16 x 16 px on."""
    path = work / "input"
    for name, arguments in MADE.items():
        if not (path / name).exists():
            code, said = ended(start(path, Command(arguments)))
            if code:
                raise RuntimeError(said)
    shutil.copytree(path / "capture", path / "frames", dirs_exist_ok=True)
    for name in ("first", "second"):
        shutil.copytree(path / "few", path / "boxes" / name, dirs_exist_ok=True)
    (path / "frames" / "capture.toml").unlink()
    (path / "reading.csv").write_text("wavelength_nm,radiance\n380,0.001\n780,0.005\n", encoding="utf-8")


def cases(options: argparse.Namespace, commands: list[str]) -> Iterator[tuple[str, str, int]]:
    for name in commands:
        for kind in options.kinds.split(","):
            for number in range({"kill": options.moments, "pipe": 1}.get(kind, options.pairs)):
                yield name, kind, number


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--moments", type=int, default=20, help="kills per command")
    parser.add_argument("--pairs", type=int, default=5, help="cases of each other kind per command")
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--kinds", default=",".join(KINDS if os.geteuid() == 0 else KINDS.keys() - AS_ROOT))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--forked", action="store_true", help="many cases, of commands that do not render")
    options = parser.parse_args()
    work = options.work.resolve()
    prepare(work)
    if options.forked:
        import_all()
        faults_runs.FORKED = True
    record = work / "faults.jsonl"
    lines = record.read_text(encoding="utf-8").splitlines() if record.exists() else []
    done = {(c["command"], c["kind"], c["number"]): c for c in map(json.loads, lines)}
    undisturbed: dict[str, Undisturbed] = {}
    for name, kind, number in cases(options, options.commands.split(",")):
        if (name, kind, number) in done:
            continue
        if name not in undisturbed:
            undisturbed[name] = plain = Undisturbed(work, COMMANDS[name], name)
            varying = sorted(set(plain.whole) - plain.steady)
            print(f"{name}: {plain.seconds:.1f} s, other bits at each run: {varying}", flush=True)
        plain = undisturbed[name]
        if kind == "cache" and not plain.kilobytes["cache"]:
            continue
        path = work / name / kind
        shutil.rmtree(path, ignore_errors=True)
        moment = random.Random(f"{options.seed} {name} {kind} {number}").random()
        plain.moments = 1
        fault = KINDS[kind](path, COMMANDS[name], plain, moment, number)
        case = {"command": name, "kind": kind, "number": number, "moment": moment, "fault": fault}
        done[name, kind, number] = case = case | {"moments": plain.moments}
        with record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(case) + "\n")
        if fault:
            print(f"{name} {kind} {number} at {moment:.2f}: {fault}", flush=True)
    counts: dict[tuple[str, str], list[int]] = {}
    for (name, kind, _), case in sorted(done.items()):
        sums = counts.setdefault((name, kind), [0, 0, 0])
        for index, value in enumerate((1, case.get("moments", 1), bool(case["fault"]))):
            sums[index] += value
    for (name, kind), (count, moments, failed) in counts.items():
        print(f"{name:12} {kind:10} {count:4} cases, {moments:4} moments, {failed} failures")


if __name__ == "__main__":
    main()
