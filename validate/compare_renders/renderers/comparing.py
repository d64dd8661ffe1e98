"""Several renderers on one box: exported, run, judged, written."""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.rendering.export import Exported, as_rendered, read_rendered, write_export
from cboxlab.rendering.files import write_cube
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined
from cboxlab.utils.files import origin, replacing, temporary_folder
from cboxlab.utils.progress import NO_PROGRESS, Progress, share

from .judging import REFERENCE_SAMPLES, Judged, judge, noise_of, reference_cube, write_bias_map
from .running import missing, run_renderer

__all__ = ["ComparedRenderers", "compare_renderers"]


@dataclass(frozen=True, eq=False)
class ComparedRenderers:
    """judged : one for each renderer that ran. left_out : a sentence for each that is not installed. failed : for each
    that was run without a picture.

    costs : name, variance (see ``Judged``), CPU s and elapsed s, of ours first.
    """

    judged: tuple[Judged, ...]
    left_out: tuple[str, ...]
    failed: tuple[InputError, ...]
    costs: tuple[tuple[str, float, float, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """All figures."""
        keys = ("variance", "cpu_s", "wall_s")
        return {
            "renderers": [item.to_dict() for item in self.judged],
            "left_out": list(self.left_out),
            "failed": [str(error) for error in self.failed],
            "costs": {name: dict(zip(keys, values, strict=True)) for name, *values in self.costs},
        }


def compare_renderers(
    exported: Exported,
    names: Sequence[str],
    out: Path | None = None,
    progress: Progress = NO_PROGRESS,
    samples: int = REFERENCE_SAMPLES,
) -> ComparedRenderers:
    """Run renderers on an export and judge their cubes by our own picture.

    out : a new folder for the export, the cubes, the bias maps and renderers.json; None keeps nothing. Where a run
    into it was interrupted, what renderers had finished is used. samples : of our picture, per pixel and batch. Raises
    InputError for what cannot be exported, and where every renderer fails.
    """
    lacking = {name: missing(name) for name in names}
    left_out = tuple(sentence for sentence in lacking.values() if sentence)
    with temporary_folder() as temporary:
        folder = out or temporary / "export"
        write_export(folder, exported)
        cpu, wall = _times()
        reference = reference_cube(exported, share(progress, 0.0, 0.3), samples)
        done = _times()
        costs = [("ours", noise_of(reference, reference), done[0] - cpu, done[1] - wall)]
        judged, failed = [], []
        ready = [name for name in names if not lacking[name]]
        # by whether a lamp reflects: one more for renderers in which none does
        references = {exported.lamp_reflects: reference}
        for index, name in enumerate(ready):
            own = share(progress, 0.3 + 0.7 * index / len(ready), 0.3 + 0.7 * (index + 1) / len(ready))
            try:
                run = run_renderer(folder, name)
                own.part(0.5)
                cube, shown = read_rendered(folder, name), as_rendered(exported, name)
            except InputError as error:
                failed.append(error)
                continue
            lamp = shown.lamp_reflects
            if lamp not in references:
                references[lamp] = reference_cube(shown, share(own, 0.5, 0.6), samples)
            judged.append(judge(name, cube, references[lamp], shown, run, share(own, 0.6, 1.0)))
            costs.append((name, judged[-1].variance, run.cpu_s, run.wall_s))
            if out is not None:
                write_cube(out / f"{name}.nc", cube.assign_attrs(origin(renderer=name)))
                write_bias_map(out / f"bias-{name}.png", judged[-1])
        if failed and not judged:
            raise combined(failed)
        if out is not None:
            for lamp, cube in references.items():
                stated = lamp == exported.lamp_reflects
                path = out / ("reference.nc" if stated else "reference-black-lamp.nc")
                write_cube(path, cube.assign_attrs(origin(renderer="cboxlab")))
        found = ComparedRenderers(tuple(judged), left_out, tuple(failed), tuple(costs))
        if out is not None:
            with replacing(out / "renderers.json") as path:
                path.write_text(json.dumps(found.to_dict(), indent=1) + "\n", encoding="utf-8")
    return found


def _times() -> tuple[float, float]:
    """CPU seconds of this process, and the clock."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, time.perf_counter()
