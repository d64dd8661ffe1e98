"""CPU seconds and memory of `cbox calibrate` and `cbox diagnose` on a capture of many megapixels.

    python benchmarks/speed/large_pictures.py                          # 24 megapixels: some minutes, 3 GB of disk
    python benchmarks/speed/large_pictures.py --whole 2 --diagnose
    python benchmarks/speed/large_pictures.py --diagnose --hide veiling-glare --keep FOLDER
    python benchmarks/speed/large_pictures.py --diagnose --mosaic RGGB

A picture of 304 x 304 px is rendered. Each of its pixels becomes a block of equal light on the sensor: seven bands with
two repeats, darks, flats and references. With ``--mosaic`` it is a colour sensor, whose channels are
the bands. The capture states window and binning, so that a block in use is a pixel of the picture,
and the model of the box is right. With ``--hide`` it contains one effect. With ``--whole`` a smaller capture is
calibrated too, its single pixels as they are: the way before frames were reduced. What the former takes for each
megapixel is the smaller. Exit code 1 if a command fails, or if calibration takes more than 60 CPU seconds or 3 GB, or
diagnosis more than 120.
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
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
import tomli_w
from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.image import RenderedImage, RenderJob
from cboxlab.rendering.integrators.precision import render_to_precision
from cboxlab.rendering.model.model_file import load_model
from cboxlab.rendering.synthetic import (
    CaptureSettings,
    Frame,
    MosaicSensor,
    behind_mosaic,
    interleaved,
    write_photographs,
)
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.predict import transported
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photographed_light, photographed_scene
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

_CBOX = str(Path(sys.executable).with_name("cbox"))
#: Pixels a side of the picture: about 256 across the box, as the program chooses in large frames.
_PICTURE_PX = 304
#: Pixels a side of the picture whose magnification is calibrated without blocks.
_WHOLE_PX = 64
#: Relative error of the picture before its smoothing, median over pixels. A third of it remains inside surfaces: less
#: than the error that a prediction counts for itself.
_PICTURE_ERROR = 0.002
#: Effects that may be hidden, with their numbers: about a percent of the light.
_HIDDEN: dict[str, dict[str, float | str]] = {
    "gloss": {"material": "white", "specular": 0.06, "roughness": 0.2},
    "veiling-glare": {"fraction": 0.01},
    "defocus": {"sigma_px": 0.5},
    "vignetting": {"edge_loss": 0.03},
}
#: Seed of camera and noise.
_SEED = 3
#: Bounds of a capture of 24 megapixels: CPU seconds of calibration and of diagnosis, and memory, GB.
_CALIBRATION_S, _DIAGNOSIS_S, _LARGEST_GB = 60.0, 120.0, 3.0

#: Expected light (channel, y, x) above dark in DN, by kind and filter of a frame; one channel without a mosaic.
Lights = dict[tuple[str, str | None], NDArray[np.float64]]


def write_small(folder: Path, side_px: int, settings: CaptureSettings, hidden: str | None) -> Lights:
    """A capture of the published box at ``side_px``, and the light of its frames without noise."""
    model, camera = load_model("cornell-box"), perturbed_camera(side_px, _SEED)
    effects = () if hidden is None else (AppliedEffect(catalogue()[hidden], _HIDDEN[hidden]),)
    scene, lights = photographed_scene(model), Lights()
    image = render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=_SEED), _PICTURE_ERROR)
    image = transported(smoothed(image), scene, camera, effects, _SEED)
    signals, field, hooks = photographed_light(image, effects, scene, camera, settings)

    def light(frame: Frame, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        changed = hooks.light(frame, signal)
        if frame.kind != "dark":
            behind = [index for index, band in enumerate(settings.bands) if band.filter == frame.filter]
            planes = (signals if frame.kind == "band" else field)[behind]
            sensor = interleaved(planes, [settings.bands[index] for index in behind], settings.mosaic)
            factor = np.divide(changed, sensor, out=np.ones_like(sensor), where=sensor > 0)
            lights[frame.kind, frame.filter] = planes * factor
        return changed

    write_photographs(
        folder,
        signals,
        field,
        image.sees_lamp,
        camera=camera,
        scene=scene,
        settings=settings,
        seed=_SEED,
        hooks=replace(hooks, light=light),
    )
    return lights


def smoothed(image: RenderedImage) -> RenderedImage:
    """The picture averaged over 3 x 3 pixels where these show one surface alone, as if with nine times the samples."""
    alone, surface = image.single_surface, image.surface
    same = minimum_filter(alone, 3) & (minimum_filter(surface, 3) == maximum_filter(surface, 3))
    averaged = uniform_filter(image.coefficients, (1, 3, 3, 1))
    return replace(image, coefficients=np.where(same[..., None], averaged, image.coefficients))


def expected_frames(
    small: Capture, settings: CaptureSettings, lights: Lights
) -> Iterator[tuple[tuple[str, ...], NDArray[np.float64], float]]:
    """Frames of each table, their expected light (channel, y, x) in DN without noise, and their dark level in DN."""
    dark = {table.exposure_s: float(np.median(small.frames(table))) for table in small.manifest.darks}
    for table in small.manifest.darks:
        yield table.frames, np.zeros((len(settings.bands), *small.shape)), dark[table.exposure_s]
    filters = {band.id: band.filter for band in settings.bands}
    tables = [("band", band.id, band) for band in small.manifest.band]
    for kind, rows in (("flat", small.manifest.flats), ("reference", small.manifest.reference)):
        tables += [(kind, table.band, table) for table in rows]
    # the channels of a mosaic share their frames
    for names in dict.fromkeys(table.frames for _, _, table in tables):
        kind, band, table = next(entry for entry in tables if entry[2].frames == names)
        yield names, lights[kind, filters[band]], dark[table.exposure_s]


def channel_rows(mosaic: MosaicSensor | None, width_px: int) -> NDArray[np.int64]:
    """(row of the pattern, column) index of each pixel's channel; zeros without a mosaic."""
    if mosaic is None:
        return np.zeros((1, width_px), np.int64)
    letters, rows = [*mosaic.dyes], pattern_rows(mosaic.pattern)
    tile = np.array([[letters.index(letter) for letter in row] for row in rows])
    return np.tile(tile, (1, -(-width_px // tile.shape[1])))[:, :width_px]


def pattern_rows(pattern: str) -> list[str]:
    """Rows of one repeat of a mosaic."""
    return pattern.split() if " " in pattern else [pattern[:2], pattern[2:]]


def write_magnified(
    folder: Path, side_px: int, times: int, *, binning: int, hidden: str | None = None, pattern: str = ""
) -> None:
    """A capture of a picture of ``side_px`` with ``times`` as many rows and columns.

    A pixel is smaller, and lamp and sphere are brighter by as much: it has the counts of the pixel it lies in.
    """
    settings = behind_mosaic(CaptureSettings(), pattern) if pattern else CaptureSettings()
    lights = write_small(folder / "small", side_px, settings, hidden)
    small = load_capture(folder / "small")
    camera, generator = small.manifest.camera, np.random.default_rng(0)
    gain, read, largest = camera.gain_e_per_dn or 1.0, camera.read_noise_e or 0.0, small.full_scale_dn
    (folder / "frames").mkdir(parents=True)
    channels = channel_rows(settings.mosaic, times * small.shape[1])
    columns = np.arange(channels.shape[1])
    for names, light, level in expected_frames(small, settings, lights):
        for name in names:
            frame = np.empty(tuple(times * side for side in small.shape), np.uint16)
            for row in range(small.shape[0]):  # a row of blocks at a time
                wide = np.repeat(np.maximum(light[:, row], 0.0), times, axis=1).astype(np.float32)
                mean = wide[channels[np.arange(row * times, (row + 1) * times) % len(channels)], columns]
                noise = generator.standard_normal(mean.shape, np.float32)
                counts = mean + level + np.sqrt(mean / gain + (read / gain) ** 2) * noise
                frame[row * times : (row + 1) * times] = np.clip(np.rint(counts), 0, largest)
            tifffile.imwrite(folder / name, frame, photometric="minisblack", metadata=None)
    _write_tables(folder, times)
    manifest = tomllib.loads((folder / "small" / "capture.toml").read_text(encoding="utf-8"))
    keys, width, height = manifest["camera"], times * camera.width_px, times * camera.height_px
    keys |= {"width_px": width, "height_px": height, "window_px": [0, 0, width, height], "binning": binning}
    keys["pixel_pitch_um"] = keys["pixel_pitch_um"] / times
    manifest["geometry"]["point_sigma_px"] = times * manifest["geometry"].get("point_sigma_px", 0.15)
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest), encoding="utf-8")
    shutil.rmtree(folder / "small")


def _write_tables(folder: Path, times: int) -> None:
    """Spectra with brighter lamp and sphere, and points in the larger picture."""
    shutil.copytree(folder / "small" / "spectra", folder / "spectra")
    for name in ("lamp.csv", "sphere.csv"):
        header, *rows = csv.reader((folder / "spectra" / name).open(encoding="utf-8"))
        brighter = [[nm, *(f"{times**2 * float(value):.9g}" for value in values)] for nm, *values in rows]
        _write_csv(folder / "spectra" / name, [header, *brighter])
    header, *rows = csv.reader((folder / "small" / "points.csv").open(encoding="utf-8"))
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


def magnification(megapixels: float, side_px: int, pattern: str = "") -> int:
    """Factor of rows and columns that gives a number of megapixels: of a mosaic one by which its pattern stays."""
    step = 2 * len(pattern_rows(pattern)) if pattern else 1
    return max(1, 1 + step * round((float(np.sqrt(1e6 * megapixels)) / side_px - 1) / step))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megapixels", type=float, default=24.0)
    parser.add_argument("--cells", type=int, default=_PICTURE_PX, help="blocks a side that are in use")
    parser.add_argument("--whole", type=float, help="megapixels of a capture whose single pixels are calibrated")
    parser.add_argument("--hide", choices=sorted(_HIDDEN), help="effect that the capture contains")
    parser.add_argument("--mosaic", default="", help="pattern of a colour sensor, such as RGGB")
    parser.add_argument("--diagnose", action="store_true", help="diagnose the large capture too")
    parser.add_argument("--keep", type=Path, help="folder in which the large capture stays, and is used again")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        work, passed = Path(name), True
        if options.whole is not None:
            write_magnified(work / "whole", _WHOLE_PX, magnification(options.whole, _WHOLE_PX), binning=1)
            arguments = ("calibrate", f"{work}/whole", "--out", f"{work}/calibration")
            passed &= measured(f"calibrate, {options.whole:g} megapixels, single pixels", *arguments)[2]
        large = options.keep or work / "large"
        if not (large / "capture.toml").exists():
            times = magnification(options.megapixels, options.cells, options.mosaic)
            write_magnified(large, options.cells, times, binning=times, hidden=options.hide, pattern=options.mosaic)
        for command, bound in (("calibrate", _CALIBRATION_S), ("diagnose", _CALIBRATION_S + _DIAGNOSIS_S)):
            if command == "calibrate" or options.diagnose:
                arguments = (command, str(large), "--out", f"{work}/{command}")
                cpu, memory, ended = measured(f"{command}, {options.megapixels:g} megapixels, reduced", *arguments)
                passed &= ended and cpu < bound and memory < _LARGEST_GB
    return int(not passed)


if __name__ == "__main__":
    sys.exit(main())
