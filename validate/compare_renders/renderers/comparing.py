"""Several renderers on one box: export, runs, comparisons with ours, files."""

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
from cboxlab.utils.table import Table

from .judging import REFERENCE_SAMPLES, Judged, judge, noise_of, reference_cube, write_bias_map
from .running import missing, run_renderer

__all__ = ["ComparedRenderers", "compare_renderers"]


@dataclass(frozen=True, eq=False)
class ComparedRenderers:
    """Outcome of ``compare_renderers``."""

    #: Comparison of each renderer that ran.
    judged: tuple[Judged, ...]
    #: A sentence for each renderer that is not installed.
    left_out: tuple[str, ...]
    #: The error of each renderer that ran without a result.
    failed: tuple[InputError, ...]
    #: Name, variance (see ``Judged``), CPU seconds and elapsed seconds of each renderer, ours first.
    costs: tuple[tuple[str, float, float, float], ...]

    def lines(self) -> list[str]:
        """Finding on each renderer, then those that were left out.

        Returns
        -------
        list of str
            The sentences.
        """
        names = ", ".join(judged.renderer for judged in self.judged)
        lines = [f"Compared with the reference of cboxlab: {names or 'no renderer'}"]
        for judged in self.judged:
            lines.append(f"{judged.renderer}: {judged.sentence}")
            if judged.remark:
                lines.append(f"• {judged.renderer} and the reference render a different scene here: {judged.remark}")
        return [*lines, *(f"• {sentence}" for sentence in self.left_out)]

    def tables(self) -> list[Table]:
        """Differences by surface and by wavelength, noise and time.

        Returns
        -------
        list of Table
            Three tables; none if no renderer ran.
        """
        if not self.judged:
            return []
        names = [judged.renderer for judged in self.judged]
        surfaces = tuple(
            (name, *(_percent(*judged.surfaces[name]) for judged in self.judged)) for name in self.judged[0].surfaces
        )
        bands = tuple(
            (f"{nm:g}", *(_band_percent(judged, index) for judged in self.judged))
            for index, nm in enumerate(self.judged[0].wavelength_nm)
        )
        costs = tuple(
            (name, f"{100 * variance**0.5:.3g}", f"{cpu_s:.1f}", f"{wall_s:.1f}", f"{variance * cpu_s:.3g}")
            for name, variance, cpu_s, wall_s in self.costs
        )
        return [
            Table("Difference from the reference by surface, % ± standard deviation", ("surface", *names), surfaces),
            Table("Difference by wavelength, % ± standard deviation", ("nm", *names), bands),
            Table("Noise and time", ("renderer", "error, %", "CPU s", "elapsed s", "variance × CPU s"), costs),
        ]

    def to_dict(self) -> dict[str, Any]:
        """All figures.

        Returns
        -------
        dict
            Content of renderers.json.
        """
        keys = ("variance", "cpu_s", "wall_s")
        return {
            "renderers": [item.to_dict() for item in self.judged],
            "left_out": list(self.left_out),
            "failed": [str(error) for error in self.failed],
            "costs": {name: dict(zip(keys, values, strict=True)) for name, *values in self.costs},
        }


def _percent(difference: float, sigma: float) -> str:
    """Relative difference and its standard deviation, in per cent."""
    return f"{100 * difference:+.2f} ± {100 * sigma:.2f}"


def _band_percent(judged: Judged, index: int) -> str:
    """Relative difference of one wavelength."""
    for row in judged.outcome.of_kind("band"):
        if row.name == f"{judged.wavelength_nm[index]:.10g}":
            return _percent(row.difference, row.sigma)
    return "no light"


def compare_renderers(
    exported: Exported,
    names: Sequence[str],
    out: Path | None = None,
    progress: Progress = NO_PROGRESS,
    samples: int = REFERENCE_SAMPLES,
) -> ComparedRenderers:
    """Run renderers on an export and compare their cubes with our own rendering.

    Parameters
    ----------
    exported
        The export.
    names
        Identifiers of the renderers. Those that are not installed are left out.
    out
        New folder for the export, the cubes, the bias maps and renderers.json; None for no files. Where an earlier
        run into it was interrupted, its finished renderings are used.
    progress
        Receiver of the finished part.
    samples
        Samples of our rendering, per pixel and batch.

    Returns
    -------
    ComparedRenderers
        Comparisons, renderers left out, failures, costs.

    Raises
    ------
    InputError
        If a renderer is unknown, if the files cannot be written, or if every renderer fails.
    """
    lacking = {name: missing(name) for name in names}
    left_out = tuple(sentence for sentence in lacking.values() if sentence)
    with temporary_folder() as temporary:
        folder = out or temporary / "export"
        write_export(folder, exported)
        cpu, wall = _times()
        reference = reference_cube(exported, share(progress, 0.0, 0.3), samples)
        cpu_end, wall_end = _times()
        costs = [("ours", noise_of(reference, reference), cpu_end - cpu, wall_end - wall)]
        judged, failed = [], []
        ready = [name for name in names if not lacking[name]]
        # keyed by whether a lamp reflects; renderers without reflecting lamps need a second rendering
        references = {exported.lamp_reflects: reference}
        for index, name in enumerate(ready):
            stage = share(progress, 0.3 + 0.7 * index / len(ready), 0.3 + 0.7 * (index + 1) / len(ready))
            try:
                run = run_renderer(folder, name)
                stage.part(0.5)
                cube, scene = read_rendered(folder, name), as_rendered(exported, name)
            except InputError as error:
                failed.append(error)
                continue
            lamp = scene.lamp_reflects
            if lamp not in references:
                references[lamp] = reference_cube(scene, share(stage, 0.5, 0.6), samples)
            judged.append(judge(name, cube, references[lamp], scene, run, share(stage, 0.6, 1.0)))
            costs.append((name, judged[-1].variance, run.cpu_s, run.wall_s))
            if out is not None:
                write_cube(out / f"{name}.nc", cube.assign_attrs(origin(renderer=name)))
                write_bias_map(out / f"bias-{name}.png", judged[-1])
        if failed and not judged:
            raise combined(failed)
        if out is not None:
            for lamp, cube in references.items():
                path = out / ("reference.nc" if lamp == exported.lamp_reflects else "reference-black-lamp.nc")
                write_cube(path, cube.assign_attrs(origin(renderer="cboxlab")))
        compared = ComparedRenderers(tuple(judged), left_out, tuple(failed), tuple(costs))
        if out is not None:
            with replacing(out / "renderers.json") as path:
                path.write_text(json.dumps(compared.to_dict(), indent=1) + "\n", encoding="utf-8")
    return compared


def _times() -> tuple[float, float]:
    """CPU seconds of this process, and seconds of a clock."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, time.perf_counter()
