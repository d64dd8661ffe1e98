"""How much picture a CPU second buys: our integrators against stock Mitsuba and against bare ray tracing.

    python benchmarks/rendering/spectral_engine.py [--json] [--parts default,specfilm,mono,floor,bands,bias,...]
                                         [--size 256] [--samples 64] [--rounds 8] [--bias-error 0.00014]

The published box and camera, --size pixels square, 31 bands from 400 to 700 nm (the part "bands": 76 too),
pixels that see the lamp left out. Every contender lives in a separate process, renders once to warm up, and
then one picture with a new seed whenever its turn comes, so that all meet the same disturbances. Costs are
CPU seconds of all threads (but one for BLAS, whose idle threads spin) and hold all that a picture needs. An
error is the relative variance of one picture from the scatter of the rounds, the median over pixels (freed of
the median's own bias), then over bands. Efficiency is 1 / (CPU seconds x relative variance),
cpu_seconds_to_0.3_percent the inverse of that over 0.003^2.

"floor" traces a picture's own rays again, bare: fraction_of_ray_floor is that over the picture's cost (median of
nine turns); fraction_of_ray_floor_long is the path tracer's at 128 x 128 pixels and 1024 samples.
"mono" renders 6 of the 31 bands and counts their mean cost 31 times. "bias" (bias.py) compares means over each
surface, rendered to --bias-error each: the path tracer with stock Mitsuba at three bands, the default with
the path tracer at all; max_bias is the largest relative difference, next to it its standard error and how the
differences over their standard errors are distributed (the default's is what smaller patches change, which is less
noisy; the comparison stands next to it); and it measures the white furnace. "slope", "pixels",
"threads", "start", "general", "derivatives" and "sensor" are described in engine_parts.py.
The last line is one JSON object; --json prints nothing else. What was left out is null there.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.scenes import cornell_box, cornell_camera
from contenders import BANDS, GATHER_FACTOR, MONO_BANDS, contender
from scipy.stats import chi2

SMALL = ("slope", "pixels", "threads", "start", "general", "derivatives", "sensor")
#: The part "floor": a picture of many samples, as paths are used. With few, lanes wait for their neighbours at the end.
FLOOR_SIZE, FLOOR_SAMPLES, FLOOR_ROUNDS = 128, 1024, 9
#: Samples whose rays are recorded and traced as bare rays.
FLOOR_RECORDED = 8
#: Time to trace bare rays before and after each picture, in seconds: the machine's speed varies.
FLOOR_SECONDS = 1.0
PARTS = ("default", "specfilm", "mono", "floor", "bands", "bias", *SMALL)


def _serve(name: str, size: int, samples: int, pipe: Connection) -> None:
    """A contender's process: a seed in, cost and picture out, until None arrives."""
    render = contender(name, cornell_box(), cornell_camera(size), samples)
    while (seed := pipe.recv()) is not None:
        wall, cpu = time.perf_counter(), time.process_time()
        picture = render(seed)
        cost = time.process_time() - cpu, time.perf_counter() - wall
        pipe.send((*cost, _peak_memory_mib(), picture.astype(np.float32)))


def _peak_memory_mib() -> float:
    """Of this process; what getrusage says holds the parent's as well."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024


class Contender:
    """A contender's process and what it has brought: costs, and the sum and sum of squares of pictures."""

    def __init__(self, name: str, size: int, samples: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.name, self.cpu, self.wall, self.memory_mib = name, [], [], 0.0  # type: ignore[var-annotated]
        self.pictures: list[np.ndarray] = []
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(name, size, samples, other), daemon=True)
        self._process.start()
        other.close()
        self.turn(0, keep=False)

    def turn(self, seed: int, keep: bool = True) -> None:
        """Render one picture."""
        self._pipe.send(seed)
        cpu, wall, self.memory_mib, picture = self._pipe.recv()
        if keep:
            self.cpu.append(cpu)
            self.wall.append(wall)
            self.pictures.append(picture)

    def close(self) -> None:
        """End the process."""
        self._pipe.send(None)
        self._process.join()

    @property
    def cost(self) -> float:
        """CPU seconds of one picture, median over rounds."""
        return float(np.median(self.cpu))

    @property
    def mean(self) -> np.ndarray:
        """(y, x, band)."""
        return np.mean(self.pictures, axis=0, dtype=float)

    @property
    def variance_of_mean(self) -> np.ndarray:
        """(y, x, band)."""
        return np.var(self.pictures, axis=0, ddof=1, dtype=float) / len(self.pictures)

    def relative_variance(self, used: np.ndarray, truth: np.ndarray) -> float:
        """Of one picture: median over the pixels ``used`` (y, x), then over bands; relative to ``truth``."""
        rounds = len(self.pictures)
        bias = chi2.median(rounds - 1) / (rounds - 1)
        ratio = rounds * self.variance_of_mean[used] / truth[used] ** 2
        return float(np.median(np.median(ratio, axis=0))) / bias


def _without_lamp(size: int) -> np.ndarray:
    """(y, x) whether a pixel sees surfaces and no lamp."""
    from cboxlab.rendering.visibility.primary import facet_coverage
    from cboxlab.rendering.visibility.tracer import build_tracer

    coverage = facet_coverage(build_tracer(cornell_box()), cornell_camera(size), samples=256)
    return (coverage[..., -1] == 0) & (coverage.sum(axis=-1) > 0.5)


def _floors(contenders: dict[str, Contender], size: int, samples: int, say: Callable[..., None]) -> dict[str, float]:
    """Of each of our contenders, and of the path tracer with many samples ("long"): bare rays over the whole cost."""
    from ray_floor import bare_seconds, own_rays

    contenders["long"] = Contender("path", FLOOR_SIZE, FLOOR_SAMPLES)
    traced = {"path": size**2 * samples, "long": FLOOR_SIZE**2 * FLOOR_SAMPLES}
    if "default" in contenders:
        traced["default"] = size**2 * samples * GATHER_FACTOR
    box = cornell_box()
    rays = {
        kind: own_rays(kind, box, cornell_camera(FLOOR_SIZE), BANDS, FLOOR_RECORDED)
        for kind in ("path", "default")
        if kind in traced
    }
    fractions: dict[str, list[float]] = {name: [] for name in traced}
    for seed in range(1000, 1000 + FLOOR_ROUNDS):
        for name, count in traced.items():
            floor_rays = rays["path" if name == "long" else name]
            before = bare_seconds(box, floor_rays, FLOOR_SECONDS)
            contenders[name].turn(seed)
            bare = (before + bare_seconds(box, floor_rays, FLOOR_SECONDS)) / 2 / (FLOOR_SIZE**2 * FLOOR_RECORDED)
            fractions[name].append(bare * count / contenders[name].cpu[-1])
            say(f"floor: {name}, {fractions[name][-1]:.1%}")
    return {name: float(np.median(values)) for name, values in fractions.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the JSON object only")
    parser.add_argument("--parts", default=",".join(PARTS), help="comma-separated, of " + ", ".join(PARTS))
    parser.add_argument("--size", type=int, default=256, help="width and height, pixels")
    parser.add_argument("--samples", type=int, default=64, help=f"per pixel (default: {GATHER_FACTOR} times)")
    parser.add_argument(
        "--bias-error", type=float, default=0.00014, help="relative, of a surface's mean, of the part bias"
    )
    parser.add_argument("--rounds", type=int, default=8, help="pictures of each contender, at least 2")
    options = parser.parse_args()
    parts = set(options.parts.split(","))
    if unknown := parts - set(PARTS):
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    say = (lambda *values_said: None) if options.json else (lambda *values_said: print(*values_said, flush=True))

    # here, before the long work, and not above, where each contender's process would import them
    from bias import furnace, refinement_bias, surface_bias
    from engine_parts import SMALL_PARTS

    names = ["path"] + [name for name in ("default", "specfilm", "mono") if name in parts]
    names += [f"{name}-76" for name in ("path", "default") if name in names and "bands" in parts]
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read by the contenders' processes
        os.environ[variable] = "1"
    contenders = {name: Contender(name, options.size, options.samples) for name in names}
    for seed in range(1, options.rounds + 1):
        for rival in contenders.values():
            rival.turn(seed)
        say(f"round {seed}: CPU s", {name: round(c.cpu[-1], 2) for name, c in contenders.items()})
    used = _without_lamp(options.size)
    errors = {}
    for name, c in contenders.items():
        # our own least noisy mean of the same bands: stock pictures of few samples have black pixels
        ours = "default" if "default" in parts else "path"
        truth = contenders[f"{ours}-76" if name.endswith("-76") else ours].mean
        subset = MONO_BANDS if name == "mono" else slice(None)
        errors[name] = c.relative_variance(used & (truth.min(axis=-1) > 0), truth[..., subset])
    costs = {name: c.cost for name, c in contenders.items()}
    if "mono" in costs:
        costs["mono"] *= len(BANDS) / len(MONO_BANDS)
    for name, c in contenders.items():
        say(
            f"{name:12} CPU {costs[name]:8.2f} s, wall {np.median(c.wall):7.2f} s, {c.memory_mib:6.0f} MiB, "
            f"one picture's error {100 * errors[name] ** 0.5:.3f}%"
        )

    def summary(name: str) -> dict[str, Any]:
        efficiency = {n: 1 / (costs[n] * errors[n]) for n in contenders}
        values: dict[str, Any] = {
            f"efficiency_vs_{stock}": efficiency[name] / efficiency[stock] if stock in costs else None
            for stock in ("specfilm", "mono")
        }
        values["fraction_of_ray_floor"] = None
        values["cpu_seconds_to_0.3_percent"] = 1 / efficiency[name] / 0.003**2
        values["max_bias"] = None
        values["cost_76_over_31"] = costs[f"{name}-76"] / costs[name] if "bands" in parts else None
        return values

    result = {**summary("path"), "default": summary("default") if "default" in parts else None}
    if "floor" in parts:
        fractions = _floors(contenders, options.size, options.samples, say)
        result["fraction_of_ray_floor"] = fractions["path"]
        result["fraction_of_ray_floor_long"] = fractions["long"]
        if result["default"] is not None:
            result["default"]["fraction_of_ray_floor"] = fractions["default"]
    for rival in contenders.values():
        rival.close()
    if "bias" in parts:
        biases = surface_bias(options.bias_error, stock="specfilm" in parts)
        white = furnace(2048)
        result |= {**biases.get("path", {}), "furnace": white["path"]}
        if result["default"] is not None:
            finer = refinement_bias(256)
            # the comparison with paths is noisier than the bias that it bounds: the refinement shows its size
            result["default"] |= {"against_path": biases["default"], **finer, "furnace": white["default"]}
            say("bias by patches' size:", json.dumps(finer))
        say("bias:", json.dumps(biases), "furnace:", json.dumps(white))
    for name in [part for part in SMALL if part in parts]:
        values = SMALL_PARTS[name]()
        result[name] = values
        say(f"{name}: {json.dumps(values)}")
    result["peak_memory_mib"] = {name: round(c.memory_mib) for name, c in contenders.items()}
    result |= {"size": options.size, "samples": options.samples, "rounds": options.rounds}
    print(json.dumps(result))


if __name__ == "__main__":
    main()
