"""Time and memory of large cubes, of a capture in many bands, and of many captures in one batch.

    python benchmarks/speed/scale.py                                   # all of it: an hour on two cores
    python benchmarks/speed/scale.py --sizes 256,1024 --bands 16 --captures 20

Every figure is of one `cbox` command in a process: wall and CPU seconds, and the largest memory of a process. The
batch is then repeated with a hundredth of its results removed, and has to keep the others. Exit code 1 if a command
fails.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.scenes.spectra import Spectrum
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture

#: Captures of a batch that differ; the others are copies of them.
_DISTINCT = 20
_CBOX = str(Path(sys.executable).with_name("cbox"))


def measured(title: str, *arguments: str) -> bool:
    """Run one command and print its figures; whether it ended with exit code 0."""
    start = time.perf_counter()
    process = subprocess.Popen([_CBOX, *arguments, "--quiet"])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
    print(f"{title:40}{seconds:9.1f} s{cpu:9.1f} CPU s{usage.ru_maxrss / 1e6:8.2f} GB  exit {process.returncode}")
    return process.returncode == 0


def in_bands(folder: Path, count: int) -> None:
    """A capture of 128 x 128 pixels through ``count`` Gaussian filters of 4 nm standard deviation, 410 to 690 nm."""
    nm = np.arange(380.0, 721.0)
    filters = {
        f"b{10 * centre:.0f}": Spectrum(nm, 0.8 * np.exp(-0.5 * ((nm - centre) / 4) ** 2))
        for centre in np.linspace(410, 690, count)
    }
    write_model_capture(folder, Model(), perturbed_camera(128, 3), CaptureSettings(filters=filters), 3)


def many(folder: Path, count: int) -> None:
    """``count`` captures of 16 x 16 pixels."""
    for number in range(count):
        path = folder / f"capture-{number}"
        if number < _DISTINCT:
            arguments = (perturbed_camera(16, number), CaptureSettings(), number)
            write_model_capture(path, Model(), *arguments, relative_error=1e-2)
        else:
            shutil.copytree(folder / f"capture-{number % _DISTINCT}", path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="256,512,1024,2048", help="pixels a side of cubes, by comma")
    parser.add_argument("--bands", type=int, default=64)
    parser.add_argument("--captures", type=int, default=1000)
    options = parser.parse_args()
    passed = []
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        for size in options.sizes.split(","):
            cube = ("render", "cornell-box", "--out", f"{work}/cube.nc", "--samples", "32", "--size", size)
            passed.append(measured(f"render, {size} px, 31 wavelengths", *cube))
        in_bands(work / "bands", options.bands)
        for command in ("calibrate", "validate", "diagnose"):
            arguments = (command, f"{work}/bands", "--out", f"{work}/{command}")
            passed.append(measured(f"{command}, 128 px, {options.bands} bands", *arguments))
        many(work / "many", options.captures)
        batch = ("batch", f"{work}/many", "--out", f"{work}/out", "--what", "calibrate", "--jobs", "2")
        passed.append(measured(f"batch, {options.captures} captures", *batch))
        for number in range(0, options.captures, 100):
            shutil.rmtree(work / "out" / f"capture-{number}")
        passed.append(measured("the same, a hundredth removed", *batch))
    return int(not all(passed))


if __name__ == "__main__":
    sys.exit(main())
