"""How fast the workbench follows: from a moved parameter to new figures and pictures, by effect, and how fast it stops.

    python benchmarks/speed/studio_latency.py [CAPTURE] [--moves 8] [--pause 2] [--stops]

Times what the page waits for on the bundled capture of 128 x 128 pixels and 7 bands where none is named: the end of the
rendering in the background, which begins 1.5 s after a step, then the prediction, its chi-square and the packed
pictures. The pause between moves is that of a user. The first move of every effect is distinguished from the later
ones. Next to other work the CPU time of all threads says more than the time that passes: on a machine with nothing else
to do a move takes no longer than that. The tables are Markdown, in seconds. With all effects and the defaults it takes
12 minutes.

With ``--stops`` it times the stop alone. It renders once for each effect and records every moment at which the
rendering could have stopped. From these follows the latency of a stop at any moment: mean, 95th percentile and longest,
in CPU time and in time that passes.
``--reports-only`` leaves out checkpoints and short kernel calls, for comparison.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from cboxlab.rendering.effects import AppliedEffect, Effect, apply_checked, catalogue, names_in
from cboxlab.utils.progress import NO_PROGRESS, ProgressReporter, stoppable
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.studio import Workbench
from cboxlab.validation.app.studio.app import IDLE_S
from cboxlab.validation.app.studio.jobs import Jobs
from cboxlab.validation.app.studio.wire import view
from cboxlab.validation.predict import default_cache
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

#: Longest time that 95 % of all moves may take, s.
AIM_S = 0.5


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


async def move_times(effect: Effect, bench: Workbench, moves: int, pause: float) -> list[tuple[float, float]]:
    """Time that passes and CPU time of each move after a pause, as a step of the page takes them."""
    jobs, times = Jobs(), []

    async def nothing() -> None:
        pass

    for move in range(moves + 1):
        await asyncio.sleep(min(pause, IDLE_S))
        if pause > IDLE_S and bench.improvable:
            await jobs.start("render", bench.render, nothing, background=True)
            await asyncio.sleep(pause - IDLE_S)
        values = moved(effect, bench, 4 + 0.25 * move).values
        start, used = time.perf_counter(), time.process_time()
        await jobs.quick(lambda values=values: (bench.change(0, values, True), view(bench)))
        times.append((time.perf_counter() - start, time.process_time() - used))
    jobs.close()
    return times


class Moments(ProgressReporter):
    """Receiver of progress that records each moment at which the computation could have stopped."""

    def __init__(self) -> None:
        super().__init__()
        #: (n, 2) CPU time and time that passes, s.
        self.times_s = [_now()]

    def check(self) -> None:
        self.times_s.append(_now())


def _now() -> tuple[float, float]:
    """CPU time of all threads, and the clock."""
    return time.process_time(), time.perf_counter()


def stop_latencies(bench: Workbench, reports_only: bool) -> list[tuple[float, float, float, float]]:
    """Time of a rendering in the background, then mean, 95th percentile and longest time of a stop.

    In CPU time, then in time that passes.
    """
    moments = Moments()
    with nullcontext() if reports_only else stoppable(moments, promptly=True):
        bench.render(moments)
    moments.check()
    return [_latencies(np.sort(gaps)) for gaps in np.diff(moments.times_s, axis=0).T]


def _latencies(gaps: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Sum of sorted gaps; mean, 95th percentile and longest of the rest of a gap at a random moment."""
    # a stop at a random moment falls into a gap with the gap's share of the time, and waits for a part of it
    waits = np.linspace(0.0, gaps[-1], 10001)
    longer = np.array([np.maximum(gaps - wait, 0.0).sum() for wait in waits]) / gaps.sum()
    return float(gaps.sum()), float((gaps**2).sum() / 2 / gaps.sum()), float(waits[longer <= 0.05][0]), float(gaps[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, nargs="?", default=DEMO_CAPTURE)
    parser.add_argument("--moves", type=int, default=8)
    parser.add_argument("--pause", type=float, default=2.0, help="time between moves, s")
    parser.add_argument("--effects", nargs="*", help="identifiers; all where left out")
    parser.add_argument("--stops", action="store_true", help="time the stop of the rendering in the background alone")
    parser.add_argument("--reports-only", action="store_true", help="stops at reports of progress alone")
    arguments = parser.parse_args()
    effects = [e for e in catalogue().values() if e.numbers and (not arguments.effects or e.id in arguments.effects)]
    # one thread for matrix products, as the command sets it
    with threadpool_limits(1), TemporaryDirectory() as unsaved:
        bench = Workbench(Path(unsaved), None if arguments.stops else default_cache())
        opening, used = seconds(lambda: bench.open(arguments.capture.resolve(), None, NO_PROGRESS))
        print(f"open: {opening:.1f} s, CPU {used:.1f} s", flush=True)
        if arguments.stops:
            _print_stops(bench, effects, arguments.reports_only)
        else:
            _print_moves(bench, effects, arguments.moves, arguments.pause)


def _print_moves(bench: Workbench, effects: list[Effect], moves: int, pause: float) -> None:
    """Times of moves, a line for each effect, then one for each stage."""
    print("\n| stage | effect | first move | median | 95 % | CPU median | CPU 95 % |\n|---|---|---|---|---|---|---|")
    first: dict[str, list[float]] = defaultdict(list)
    later: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for effect in effects:
        bench.add(effect.id, {})
        times = asyncio.run(move_times(effect, bench, moves, pause))
        bench.remove(0)
        first[effect.stage].append(times[0][0])
        later[effect.stage] += times[1:]
        print(f"| {effect.stage} | {effect.id} | {times[0][0]:.3f} | {_tail(times[1:])} |", flush=True)
    for stage, times in later.items():
        print(f"| {stage} | all | {max(first[stage]):.3f} | {_tail(times)} |")
    every = [each for times in later.values() for each in times]
    print(f"| all | all | {max(map(max, first.values())):.3f} | {_tail(every)} |")
    slow = np.mean(np.array(every) > AIM_S, axis=0)
    print(f"\nMoves of more than {AIM_S} s: {100 * slow[0]:.1f} % by the clock, {100 * slow[1]:.1f} % in CPU time.")


def _print_stops(bench: Workbench, effects: list[Effect], reports_only: bool) -> None:
    """CPU time of stops, a line for each effect that is rendered in the background."""
    columns = [f"{kind}{name}" for kind in ("CPU ", "") for name in ("rendering", "mean", "95 %", "longest")]
    print(f"\n| stage | effect | {' | '.join(columns)} |\n|{'---|' * (2 + len(columns))}")
    for effect in effects:
        bench.add(effect.id, moved(effect, bench, 4).values)
        if bench.improvable:
            figures = [f"{value:.3f}" for kind in stop_latencies(bench, reports_only) for value in kind]
            print(f"| {effect.stage} | {effect.id} | {' | '.join(figures)} |", flush=True)
        bench.remove(0)


def _tail(times: list[tuple[float, float]]) -> str:
    """Median and 95th percentile of the time that passes, and of the CPU time."""
    middle, high = np.percentile(times, [50, 95], axis=0)
    return f"{middle[0]:.3f} | {high[0]:.3f} | {middle[1]:.3f} | {high[1]:.3f}"


if __name__ == "__main__":
    main()
