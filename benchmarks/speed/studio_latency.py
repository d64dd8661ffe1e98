"""How fast the workbench follows: from a moved parameter to new figures and pictures, by kind of effect.

    python benchmarks/speed/studio_latency.py [CAPTURE] [--moves 12] [--pause 2]

Times what the page waits for, the prediction, its chi-square and the packed pictures, on the bundled capture of
128 x 128 pixels and 7 bands where none is named. The first move of every effect is distinguished from the later ones,
and the opening of the capture before them; after them, how long the rendering in the background takes that follows a
moved block. The pause between moves is that of a user; caches grow cold in it. Next to other work the CPU time of all
threads says more than the time that passes: on a machine with nothing else to do a move takes no longer than that.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cboxlab.rendering.effects import AppliedEffect, Effect, apply_checked, catalogue, names_in
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.studio import Workbench
from cboxlab.validation.app.studio.wire import view
from cboxlab.validation.predict import default_cache


def seconds(step: Callable[[], object]) -> tuple[float, float]:
    """Time that passes, and CPU time of all threads."""
    start, used = time.perf_counter(), time.process_time()
    step()
    return time.perf_counter() - start, time.process_time() - used


def moved(effect: Effect, bench: Workbench, step: float) -> AppliedEffect:
    """The effect some steps of its numbers from null."""
    prepared = bench.study.prepared[0]
    names = names_in(prepared.scene, tuple(prepared.calibration.capture.band_ids))
    values = {}
    for p in effect.numbers:
        start = p.null_coordinate if p.null is not None else p.to_coordinate(p.starting_values[0])
        if np.isfinite(start):
            values[p.name] = p.from_coordinate(start + step * p.coordinate_step)
    return apply_checked(effect.id, values, "benchmark", names)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, nargs="?", default=DEMO_CAPTURE)
    parser.add_argument("--moves", type=int, default=12)
    parser.add_argument("--pause", type=float, default=2.0, help="time between moves, s")
    parser.add_argument("--effects", nargs="*", help="identifiers; all where left out")
    arguments = parser.parse_args()
    bench = Workbench(Path.cwd(), default_cache())
    opening, _ = seconds(lambda: bench.open(arguments.capture.resolve(), None, NO_PROGRESS))
    print(f"open: {opening:.1f} s", flush=True)
    print(f"\n{'':31s} {'first':>8s}   {'median':>8s}   {'95 %':>8s}   {'CPU':>8s}   {'95 %':>8s}")
    first: dict[str, list[float]] = defaultdict(list)
    later: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for effect in catalogue().values():
        if not effect.numbers or (arguments.effects and effect.id not in arguments.effects):
            continue
        bench.add(effect.id, {})
        times = []
        for move in range(arguments.moves + 1):
            time.sleep(arguments.pause)
            values = moved(effect, bench, 4 + 0.25 * move).values
            times.append(seconds(lambda values=values: (bench.change(0, values, False), view(bench))))
        bench.undo()
        first[effect.stage].append(times[0][0])
        later[effect.stage] += times[1:]
        print(f"{effect.stage:10s} {effect.id:20s} {times[0][0]:8.3f} s {_tail(times[1:])}", flush=True)
    bench.add("block-pose", {"dx_mm": 5.0})
    print(f"\nrendered in the background: {seconds(lambda: bench.render(NO_PROGRESS))[0]:.1f} s")
    for stage, times in later.items():
        print(f"{stage:31s} {max(first[stage]):8.3f} s {_tail(times)}")


def _tail(times: list[tuple[float, float]]) -> str:
    """Median and 95th percentile of the time that passes, and of the CPU time."""
    middle, high = np.percentile(times, [50, 95], axis=0)
    return f"{middle[0]:8.3f} s {high[0]:8.3f} s {middle[1]:8.3f} s {high[1]:8.3f} s"


if __name__ == "__main__":
    main()
