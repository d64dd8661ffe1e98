"""CPU seconds and memory of commands, in turn with an earlier state of the code.

    python benchmarks/speed/command_seconds.py v0.1.0                    # all commands, against a git reference
    python benchmarks/speed/command_seconds.py ../earlier --only regress --rounds 5

The earlier state is a folder with the sources, or a reference that git knows. Both states run in turn, so that other
work on the machine slows both alike. Printed for each command are the least CPU seconds of each state over the rounds,
their ratio, and the largest memory. Exit code 1 if a command fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from cboxlab.rendering.files import write_cube
from cboxlab.rendering.files.cube_checks import as_cube

ROOT = Path(__file__).resolve().parents[2]
#: Folders of the sources, and their packages inside cboxlab.
ROOMS = {"scenes": "scenes", "calibration": "calibration", "render": "rendering", "validate": "validation"}
_START = "import sys; from cboxlab.validation.app.commands.cli import main; main(sys.argv[1:])"
#: Exit codes of a finished comparison: fine, and a check that failed.
_FINISHED = (0, 1)


def commands(folder: Path, size: int, bands: int) -> dict[str, list[str]]:
    """Arguments of each command, with the cubes that they read written into a folder."""
    generator = np.random.default_rng(0)

    def cubes(name: str, height: int, width: int, count: int) -> list[str]:
        light = 0.5 + 0.5 * generator.random((height, width, 1)) + 0.3 * generator.random(count)
        paths = [folder / f"{name}-{side}.nc" for side in "ab"]
        for path in paths:
            noisy = light * (1 + 0.01 * generator.standard_normal(light.shape))
            write_cube(path, as_cube(noisy.astype(np.float32), np.linspace(400.0, 700.0, count)))
        return [str(path) for path in paths]

    capture, out = str(ROOT / "validate" / "data" / "demo-capture"), str(folder / "out")
    return {
        "help": ["--help"],
        "regress": ["regress", *cubes("small", 32, 32, 7), "--quiet"],
        "calibrate": ["calibrate", capture, "--quiet", "--out", out],
        "validate": ["validate", capture, "--no-cache", "--quiet", "--out", out],
        "diagnose": ["diagnose", capture, "--no-cache", "--quiet", "--out", out],
        "compare": ["compare", *cubes("large", size, size, bands), "--quiet"],
    }


def linked(source: Path, folder: Path) -> Path:
    """Folder for PYTHONPATH in which the sources form the package."""
    package = folder / "cboxlab"
    package.mkdir(parents=True)
    for path in (source / "cboxlab").iterdir():
        (package / path.name).symlink_to(path)
    for room, name in ROOMS.items():
        (package / name).symlink_to(source / room)
    return folder


def sources(state: str, folder: Path) -> Path:
    """Folder of a state's sources: the folder itself, or the files of a git reference."""
    if Path(state).is_dir():
        return Path(state).resolve()
    archive = subprocess.run(["git", "archive", state], cwd=ROOT, check=True, capture_output=True).stdout
    folder.mkdir()
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return folder


def measured(tree: Path, arguments: list[str]) -> tuple[float, float]:
    """CPU seconds and GB of one run."""
    # compiled modules are stored, as they are where the program is installed
    settings = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-c", _START, *arguments]
    # Python looks for modules in the current folder first
    process = subprocess.Popen(command, env=settings, cwd=tree, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in _FINISHED:
        raise RuntimeError(f"exit code {process.returncode}: cbox {' '.join(arguments)}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("earlier", help="folder of an earlier state, or a git reference")
    parser.add_argument("--rounds", type=int, default=3)
    everything = "help,regress,calibrate,validate,diagnose,compare"
    parser.add_argument("--only", default=everything, help="some of the commands")
    parser.add_argument("--size", type=int, default=512, help="pixels along each side of the large cubes")
    parser.add_argument("--bands", type=int, default=200, help="bands of the large cubes")
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trees = {
            "earlier": linked(sources(options.earlier, folder / "sources"), folder / "earlier"),
            "now": linked(ROOT, folder / "now"),
        }
        with ProcessPoolExecutor(1) as pool:  # memory of this process would count as that of its children
            every = pool.submit(commands, folder, options.size, options.bands).result()
        print(f"{'command':10}{'earlier':>10}{'now':>10} CPU s{'ratio':>8}{'earlier':>10}{'now':>8} GB")
        for command in options.only.split(","):
            runs: dict[str, list[tuple[float, float]]] = {state: [] for state in trees}
            try:
                for _ in range(options.rounds):
                    for state, tree in trees.items():
                        runs[state].append(measured(tree, every[command]))
            except RuntimeError as error:
                print(f"{command:10}{error}")
                failed = True
                continue
            (before, size), (after, size_now) = (np.min(rows, axis=0) for rows in runs.values())
            print(f"{command:10}{before:10.2f}{after:10.2f}      {after / before:8.2f}{size:10.2f}{size_now:8.2f}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
