"""How fast the workbench follows: from a moved parameter to new figures and pictures, by kind of effect.

    python benchmarks/studio_latency.py [CAPTURE] [--moves 12]

Times what the page waits for, the prediction, its chi-square and the packed pictures, on the bundled capture of
128 x 128 pixels and 7 bands where none is named. The first move of every effect is told apart from the later ones,
and the opening of the capture before them; after them, how long the rendering in the background takes that follows a
moved block.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cboxlab.scenes.progress import QUIET
from cboxlab.validate.commands.demo import DEMO_CAPTURE
from cboxlab.validate.effects import AppliedEffect, Effect, apply_checked, catalogue, names_in
from cboxlab.validate.predict import default_cache
from cboxlab.validate.studio import Workbench
from cboxlab.validate.studio.wire import view


def seconds(step: Callable[[], object]) -> float:
    start = time.perf_counter()
    step()
    return time.perf_counter() - start


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
    parser.add_argument("--effects", nargs="*", help="identifiers; all where left out")
    arguments = parser.parse_args()
    bench = Workbench(Path.cwd(), default_cache())
    print(f"open: {seconds(lambda: bench.open(arguments.capture.resolve(), None, QUIET)):.1f} s", flush=True)
    first: dict[str, list[float]] = defaultdict(list)
    later: dict[str, list[float]] = defaultdict(list)
    for effect in catalogue().values():
        if not effect.numbers or (arguments.effects and effect.id not in arguments.effects):
            continue
        bench.add(effect.id, {})
        times = []
        for move in range(arguments.moves + 1):
            values = moved(effect, bench, 4 + 0.25 * move).values
            times.append(seconds(lambda values=values: (bench.change(0, values, False), view(bench))))
        bench.undo()
        first[effect.stage].append(times[0])
        later[effect.stage] += times[1:]
        tail = np.percentile(times[1:], [50, 95])
        print(
            f"{effect.stage:10s} {effect.id:20s} first {times[0]:6.3f} s, "
            f"then median {tail[0]:.3f} s, 95 % {tail[1]:.3f} s",
            flush=True,
        )
    bench.add("block-pose", {"dx_mm": 5.0})
    print(f"\nrendered in the background: {seconds(lambda: bench.render(QUIET)):.1f} s")
    print("\nstage       first, worst   median    95 %")
    for stage, times in later.items():
        print(
            f"{stage:10s} {max(first[stage]):8.3f} s {np.median(times):8.3f} s {np.percentile(times, 95):8.3f} s"
        )


if __name__ == "__main__":
    main()
