"""CPU seconds and memory of `cbox calibrate` and `cbox diagnose` on a capture of many megapixels.

    python benchmarks/speed/large_pictures.py                          # 24 megapixels: some minutes, 3 GB of disk
    python benchmarks/speed/large_pictures.py --whole 2 --diagnose

The frames of the bundled capture of 128 x 128 px are magnified and get new noise: seven bands with two repeats, darks,
flats and references. The program chooses window and blocks. With ``--whole`` a smaller capture is calibrated too, its
single pixels as they are: the way before frames were reduced. What the former takes for each megapixel is the smaller.
Exit code 1 if a command fails, or if calibration takes more than 60 CPU seconds or 3 GB, or diagnosis more than 120.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tifffile
import tomli_w
from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

_CBOX = str(Path(sys.executable).with_name("cbox"))
#: Standard deviations of the blur that removes the noise of small frames, of the scene and of uniform fields, px.
_BLUR_PX = {"band": 0.7, "flat": 6.0, "reference": 6.0}
#: Bounds of a capture of 24 megapixels: CPU seconds of calibration and of diagnosis, and memory, GB.
_CALIBRATION_S, _DIAGNOSIS_S, _LARGEST_GB = 60.0, 120.0, 3.0


def expected_frames(small: Capture) -> Iterator[tuple[tuple[str, ...], NDArray[np.float64], float]]:
    """Frames of each table, their expected light (y, x) in DN without noise, and their dark level in DN."""
    dark = {table.exposure_s: float(np.median(small.frames(table))) for table in small.manifest.darks}
    for table in small.manifest.darks:
        yield table.frames, np.zeros(small.shape), dark[table.exposure_s]
    tables = {"band": small.manifest.band, "flat": small.manifest.flats, "reference": small.manifest.reference}
    for kind, rows in tables.items():
        for table in rows:
            level = dark[table.exposure_s]
            light = gaussian_filter(small.frames(table).mean(axis=0) - level, _BLUR_PX[kind])
            yield table.frames, np.maximum(light, 0.0), level


def write_magnified(folder: Path, times: int, *, binning: int | None = None) -> None:
    """A capture of the same light with ``times`` as many rows and columns.

    A pixel is smaller, and lamp and sphere are brighter by as much: it has the counts of the pixel it lies in.
    """
    small = load_capture(DEMO_CAPTURE)
    camera, generator = small.manifest.camera, np.random.default_rng(0)
    gain, read, largest = camera.gain_e_per_dn or 1.0, camera.read_noise_e or 0.0, small.full_scale_dn
    (folder / "frames").mkdir(parents=True)
    for names, light, level in expected_frames(small):
        for name in names:
            frame = np.empty(tuple(times * side for side in small.shape), np.uint16)
            for row, line in enumerate(light):  # a row of small pixels at a time
                mean = np.repeat(line, times).astype(np.float32)
                noise = generator.standard_normal((times, mean.size), np.float32)
                counts = mean + level + np.sqrt(mean / gain + (read / gain) ** 2) * noise
                frame[row * times : (row + 1) * times] = np.clip(np.rint(counts), 0, largest)
            tifffile.imwrite(folder / name, frame, photometric="minisblack", metadata=None)
    _write_tables(folder, times)
    with (DEMO_CAPTURE / "capture.toml").open("rb") as file:
        manifest = tomllib.load(file)
    keys = manifest["camera"]
    keys |= {"width_px": times * camera.width_px, "height_px": times * camera.height_px}
    keys["pixel_pitch_um"] = keys["pixel_pitch_um"] / times
    if binning is not None:
        keys["binning"] = binning
    manifest["geometry"]["point_sigma_px"] = times * manifest["geometry"].get("point_sigma_px", 0.15)
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest), encoding="utf-8")


def _write_tables(folder: Path, times: int) -> None:
    """Spectra with brighter lamp and sphere, and points in the larger picture."""
    shutil.copytree(DEMO_CAPTURE / "spectra", folder / "spectra")
    for name in ("lamp.csv", "sphere.csv"):
        header, *rows = csv.reader((folder / "spectra" / name).open(encoding="utf-8"))
        brighter = [[nm, *(f"{times**2 * float(value):.9g}" for value in values)] for nm, *values in rows]
        _write_csv(folder / "spectra" / name, [header, *brighter])
    header, *rows = csv.reader((DEMO_CAPTURE / "points.csv").open(encoding="utf-8"))
    moved = [[*row[:4], *(f"{(float(value) + 0.5) * times - 0.5:.3f}" for value in row[4:])] for row in rows]
    _write_csv(folder / "points.csv", [header, *moved])


def _write_csv(path: Path, rows: list[list[str]]) -> None:
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")


def measured(title: str, *arguments: str) -> tuple[float, float, bool]:
    """CPU seconds and GB of one command, printed, and whether it ended with exit code 0 or 1."""
    process = subprocess.Popen([_CBOX, *arguments, "--quiet"], env={**os.environ, "OMP_NUM_THREADS": "1"})
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu, memory = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6
    print(f"{title:44}{cpu:9.1f} CPU s{memory:8.2f} GB  exit {process.returncode}", flush=True)
    return cpu, memory, process.returncode in (0, 1)


def magnification(megapixels: float) -> int:
    """Factor of rows and columns that gives a number of megapixels."""
    return max(1, round(float(np.sqrt(1e6 * megapixels / np.prod(load_capture(DEMO_CAPTURE).shape)))))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megapixels", type=float, default=24.0)
    parser.add_argument("--whole", type=float, help="megapixels of a capture whose single pixels are calibrated")
    parser.add_argument("--diagnose", action="store_true", help="diagnose the large capture too")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        work, passed = Path(name), True
        if options.whole is not None:
            write_magnified(work / "whole", magnification(options.whole), binning=1)
            arguments = ("calibrate", f"{work}/whole", "--out", f"{work}/calibration")
            passed &= measured(f"calibrate, {options.whole:g} megapixels, single pixels", *arguments)[2]
        write_magnified(work / "large", magnification(options.megapixels))
        for command, bound in (("calibrate", _CALIBRATION_S), ("diagnose", _CALIBRATION_S + _DIAGNOSIS_S)):
            if command == "calibrate" or options.diagnose:
                arguments = (command, f"{work}/large", "--out", f"{work}/{command}")
                cpu, memory, ended = measured(f"{command}, {options.megapixels:g} megapixels, reduced", *arguments)
                passed &= ended and cpu < bound and memory < _LARGEST_GB
    return int(not passed)


if __name__ == "__main__":
    sys.exit(main())
