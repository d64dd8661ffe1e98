"""Speed and memory of the sensor simulator on a 1024 x 1024 x 31 cube, next to plain numpy in the same run."""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import xarray as xr
from cboxlab.rendering.files.cube_files import open_cube, write_cube
from cboxlab.rendering.image.spectral_basis import principal_components, to_basis
from cboxlab.rendering.sensor.cameras import load_camera
from cboxlab.rendering.sensor.light import integration_weights
from cboxlab.rendering.sensor.simulation import auto_exposure, expected_electrons, simulate_frame
from numpy.typing import NDArray

WAVELENGTH = np.arange(400.0, 701.0, 10.0)


def random_cube(size: int) -> xr.Dataset:
    """Radiance of even noise, (size, size, 31), float32."""
    radiance = np.random.default_rng(1).random((size, size, WAVELENGTH.size), np.float32)
    return xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": WAVELENGTH})


def plain(cube: xr.Dataset, exposure_s: float) -> NDArray[np.float64]:
    """The plain way: one product in double precision over the whole cube, then the mosaic."""
    camera = load_camera("dcs200")
    weights = np.stack([integration_weights(camera.channels[c], WAVELENGTH) for c in "RGB"], axis=-1)
    rgb = cube["radiance"].values.astype(np.float64) @ weights
    mosaic = rgb[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = rgb[::2, ::2, 0], rgb[1::2, 1::2, 2]
    return exposure_s * mosaic


def measured(work: Callable[[], NDArray]) -> tuple[float, float, NDArray]:
    """Best of three in seconds, peak of new memory in MiB (in a separate run), and the result."""
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - start)
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    return min(seconds), peak, result


def main() -> None:
    """Print one line per way; --json for numbers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1024, help="pixels along each side")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    cube, camera = random_cube(arguments.size), load_camera("dcs200")
    exposure = auto_exposure(cube, camera)
    coefficients = to_basis(cube, principal_components(cube, 8))
    with TemporaryDirectory() as folder:
        write_cube(Path(folder) / "cube.hdr", cube)
        with open_cube(Path(folder) / "cube.hdr") as on_disk:
            ways = {
                "plain numpy, expected electrons": lambda: plain(cube, exposure),
                "expected_electrons": lambda: expected_electrons(cube, camera, exposure),
                "expected_electrons, file on disk": lambda: expected_electrons(on_disk, camera, exposure),
                "expected_electrons, 8 components": lambda: expected_electrons(coefficients, camera, exposure),
                "simulate (with noise)": lambda: simulate_frame(cube, camera, exposure, seed=1),
            }
            results = {name: measured(work) for name, work in ways.items()}
    first, second = list(results.values())[:2]
    difference = float(np.max(np.abs(second[2] / first[2] - 1)))
    if arguments.json:
        table = {name: {"seconds": s, "peak_mib": m} for name, (s, m, _) in results.items()}
        print(json.dumps({"size": arguments.size, "ways": table, "largest_relative_difference": difference}))
        return
    for name, (seconds, peak, _) in results.items():
        faster, smaller = first[0] / seconds, first[1] / peak
        print(
            f"{name:34s} {seconds:7.3f} s  {peak:7.0f} MiB   {faster:5.1f} x as fast, 1 / {smaller:.0f} of the memory"
        )
    print(f"largest relative difference of the first two: {difference:.1e}")


if __name__ == "__main__":
    main()
