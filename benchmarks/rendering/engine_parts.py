"""Smaller measurements of the engine: slope, pixels, threads, start, other materials, derivatives, sensor."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from cboxlab.rendering.device import dr
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.integrators.derivatives import render_derivatives
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.rendering.sensor.cameras import load_camera
from cboxlab.rendering.sensor.simulation import auto_exposure, expected_electrons
from cboxlab.scenes import Material, Medium, Spectrum, cornell_box, cornell_camera
from contenders import BANDS
from sensor_speed import plain, random_cube

__all__ = ["SMALL_PARTS"]

SIZE = 128
WAYS = {"path": render_path_tracer, "default": render_final_gather}


def _cost(work: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> float:
    start = clock()
    work()
    return clock() - start


def _alternating(ways: dict[str, Callable[[], Any]], rounds: int, clock: Any = time.process_time) -> dict[str, Any]:
    """Seconds of each way, round by round after one to warm up: (rounds,) arrays."""
    for work in ways.values():
        work()
    rows = [{name: _cost(work, clock) for name, work in ways.items()} for _ in range(rounds)]
    return {name: np.array([row[name] for row in rows]) for name in ways}


def _error(image: RenderedImage) -> float:
    """Relative standard deviation of one batch, median over pixels without lamp, then over bands."""
    values = (image.coefficients @ image.spectra)[:, (image.coverage[..., -1] == 0) & (image.coverage.sum(-1) > 0.5)]
    mean, lit_spectra = values.mean(axis=0), image.spectra.max(axis=0) > 0
    ratio = (values.var(axis=0, ddof=1)[:, lit_spectra]) / np.maximum(mean[:, lit_spectra], 1e-30) ** 2
    return float(np.sqrt(np.median(np.median(ratio, axis=0))))


def slope() -> dict[str, Any]:
    """Error against samples at 64 x 64: exponent of a line in logarithms, and the errors themselves."""
    camera, result = cornell_camera(64), {}
    for name, samples in (("path", (16, 64, 256, 1024)), ("default", (64, 256, 1024, 4096))):
        errors = [_error(WAYS[name](cornell_box(), camera, BANDS, n, 8, seed=n)) for n in samples]
        exponent = float(np.polyfit(np.log(samples), np.log(errors), 1)[0])
        result[name] = {"exponent": exponent, "errors": dict(zip(map(str, samples), errors, strict=True))}
    return result


def pixels() -> dict[str, Any]:
    """CPU seconds of 64 samples a pixel for several sizes, and their exponent against pixels."""
    sizes, result = (64, 128, 256), {}
    for name, render in WAYS.items():
        ways = {
            str(s): lambda render=render, s=s: render(RenderJob(cornell_box(), cornell_camera(s), BANDS, 64, 1))
            for s in sizes
        }
        seconds = {s: float(np.median(t)) for s, t in _alternating(ways, 2).items()}
        exponent = float(np.polyfit(np.log([s**2 for s in sizes]), np.log(list(seconds.values())), 1)[0])
        result[name] = {"cpu_seconds": seconds, "exponent": exponent}
    return result


def threads() -> dict[str, Any]:
    """How much faster (wall clock) two threads are than one."""
    result = {}
    for name, render in WAYS.items():
        samples = 64 if name == "path" else 1024

        def work(count: int, render: Callable[..., Any] = render, samples: int = samples) -> None:
            dr.set_thread_count(count)
            render(RenderJob(cornell_box(), cornell_camera(256), BANDS, samples, 1))

        ways = {"1": lambda work=work: work(1), "2": lambda work=work: work(2)}
        seconds = _alternating(ways, 3, time.perf_counter)
        result[name] = float(np.median(seconds["1"] / seconds["2"]))
    dr.set_thread_count(os.cpu_count() or 1)
    return {"speedup_2_threads": result}


def start() -> dict[str, Any]:
    """Wall seconds from nothing to a 16 x 16 picture in a new process, kernels in the cache; best of three."""
    program = (
        "import numpy as np\n"
        "from cboxlab.rendering.image import RenderJob\n"
        "from cboxlab.rendering.{module} import {function} as render\n"
        "from cboxlab.scenes import cornell_box, cornell_camera\n"
        "render(RenderJob(cornell_box(), cornell_camera(16), np.linspace(400, 700, 31), samples=4, batches=1))\n"
    )
    names = {
        "path": ("integrators.path_tracer", "render_path_tracer"),
        "default": ("radiosity.final_gather", "render_final_gather"),
    }
    result = {}
    for name, (module, function) in names.items():
        command = [sys.executable, "-c", program.format(module=module, function=function)]
        run = partial(subprocess.run, command, check=True)
        seconds = [_cost(run, time.perf_counter) for _ in range(4)]
        result[name] = min(seconds[1:])
    return {"warm_start_seconds": result}


def general() -> dict[str, Any]:
    """Cost of other scenes over that of the path tracer in the plain box, 64 samples."""
    box, camera = cornell_box(), cornell_camera(SIZE)
    coat = {"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": "reflectance"}
    glass = {"type": "roughdielectric", "alpha": 0.1}
    white = box.materials["white"]
    block = tuple(replace(s, material="glass") if s.name == "tall-block" else s for s in box.surfaces)
    few = Spectrum(np.array([400.0, 700.0]), np.array([1e-3, 3e-4]))
    scenes = {
        "coat": replace(box, materials={**box.materials, "white": replace(white, bsdf=coat)}),
        "coat_not_affine": replace(
            box, materials={**box.materials, "white": replace(white, bsdf={**coat, "nonlinear": True})}
        ),
        "rough_glass_block": replace(
            box,
            surfaces=block,
            materials={**box.materials, "glass": Material("glass", white.reflectance, glass)},
        ),
        "medium": replace(box, medium=Medium(few, few.scaled(0.1))),
        "patterned_lamp": replace(box, lamp=replace(box.lamp, pattern=np.array([[0.5, 1.0], [1.0, 1.5]]))),
    }
    ways: dict[str, Callable[[], Any]] = {"path": lambda: render_path_tracer(RenderJob(box, camera, BANDS, 64, 1))}
    for name, scene in scenes.items():
        ways[name] = lambda scene=scene: render_general_path_tracer(RenderJob(scene, camera, BANDS, 64, 1))
    seconds = _alternating(ways, 3)
    return {"cost_over_path": {n: float(np.median(seconds[n] / seconds["path"])) for n in scenes}}


def derivatives() -> dict[str, Any]:
    """Cost of the picture with its derivatives over that of the picture."""
    ways: dict[str, Callable[[], Any]] = {
        "image": lambda: render_path_tracer(RenderJob(cornell_box(), cornell_camera(256), BANDS, 64, 1)),
        "with": lambda: render_derivatives(RenderJob(cornell_box(), cornell_camera(256), BANDS, 64, 1)),
    }
    seconds = _alternating(ways, 3)
    return {"derivatives_over_image": float(np.median(seconds["with"] / seconds["image"]))}


def sensor() -> dict[str, Any]:
    """Expected electrons of a 1024 x 1024 x 31 cube: over plain numpy, and the part of memory bandwidth it reaches."""
    cube, camera = random_cube(1024), load_camera("dcs200")
    seconds_exposed = auto_exposure(cube, camera)
    radiance = cube["radiance"].values
    ways: dict[str, Callable[[], Any]] = {
        "plain": lambda: plain(cube, seconds_exposed),
        "ours": lambda: expected_electrons(cube, camera, seconds_exposed),
        "read": lambda: radiance.max(),  # touches every number once
    }
    seconds = _alternating(ways, 3, time.perf_counter)
    return {
        "sensor_speed_over_numpy": float(np.median(seconds["plain"] / seconds["ours"])),
        "sensor_fraction_of_memory_bandwidth": float(np.median(seconds["read"] / seconds["ours"])),
    }


#: Name of the part to the function that measures it.
SMALL_PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    f.__name__: f for f in (slope, pixels, threads, start, general, derivatives, sensor)
}
