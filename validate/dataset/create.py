"""Making of a data set: draws, pictures, index, data card, quality sheet."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.dataset import Box, Recipe, draw_box, load_recipe
from cboxlab.rendering.device import variant
from cboxlab.rendering.sensor import integration_weights
from cboxlab.utils.arguments import require_progress, require_type, required_folder, required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import referred
from cboxlab.utils.progress import NO_PROGRESS, Progress

from .card import write_card, write_croissant
from .formats import require_format
from .layout import begin, write_index
from .memory import require_memory
from .opened import Dataset, open_dataset
from .picture import sensor_camera
from .sheet import write_sheet
from .tasks import Task, camera_names, pictures_of, tasks_of
from .workers import in_processes, on_local_cluster, on_scheduler

__all__ = ["DatasetRun", "Workers", "create_dataset", "read_recipe"]

#: Boxes that are drawn before any is rendered, 4 ms each: a fault of a rare draw should not end a long run.
_TRIED = 50

#: Seconds of an hour.
_HOUR_S = 3600.0


@dataclass(frozen=True)
class Workers:
    """Processes that render; this one alone by default."""

    #: Number of processes on this machine.
    processes: int = 1
    #: Address of a Dask scheduler; None for none.
    scheduler: str | None = None
    #: Number of processes of a Dask cluster on this machine; None for none.
    local_cluster: int | None = None


@dataclass(frozen=True, eq=False)
class DatasetRun:
    """Outcome of a run."""

    #: The data set.
    dataset: Dataset
    #: Number of pictures that this run rendered.
    rendered: int
    #: Number of pictures that were there before.
    reused: int
    #: Duration of the run, s.
    seconds: float
    #: Sum of the seconds in which pictures were rendered and written, over all processes.
    picture_seconds: float
    #: Processor time in which pictures were rendered with their truths, over all processes, s.
    rendering_processor_seconds: float
    #: Processor time of this process and of those that it started, or of the pictures on a scheduler's workers, s.
    processor_seconds: float
    #: Pictures that failed a check, with their faults.
    failed: tuple[tuple[str, str], ...]

    @property
    def per_hour(self) -> float:
        """Pictures per hour of this run; 0 if it rendered none."""
        return _HOUR_S * self.rendered / self.seconds if self.rendered else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Figures of the run.

        Returns
        -------
        dict
            Ready for JSON.
        """
        rows = self.dataset.index
        return {
            "folder": str(self.dataset.folder),
            "pictures": len(rows),
            "rendered": self.rendered,
            "reused": self.reused,
            "failed": [{"picture": name, "faults": fault} for name, fault in self.failed],
            "seconds": round(self.seconds, 1),
            "picture_seconds": round(self.picture_seconds, 1),
            "processor_seconds": round(self.processor_seconds, 1),
            "rendering_processor_seconds": round(self.rendering_processor_seconds, 1),
            "pictures_per_hour": round(self.per_hour, 1),
            "median_relative_standard_error": _median([row["relative_standard_error"] for row in rows]),
            "bytes": sum(row["bytes"] for row in rows),
        }

    def lines(self) -> list[str]:
        """Sentences about the run.

        Returns
        -------
        list of str
            Number of pictures first, failures last.
        """
        record = self.to_dict()
        count = record["pictures"]
        lines = [
            f"{count} pictures, {record['bytes'] / 1e6:.1f} MB, relative standard error "
            f"{record['median_relative_standard_error']:.2%} (median picture)",
            f"{self.rendered} rendered in {self.seconds:.0f} s ({self.per_hour:.0f} an hour), {self.reused} were there",
        ]
        if 0 < self.rendering_processor_seconds < self.processor_seconds:
            other = 1 - self.rendering_processor_seconds / self.processor_seconds
            lines.append(f"{self.processor_seconds:.0f} s of processor time, {other:.1%} of it no rendering")
        lines += [f"• {name} failed and is kept apart: {fault}" for name, fault in self.failed[:10]]
        return lines


def _median(values: list[float]) -> float:
    """Median; 0 of nothing."""
    return float(np.median(values)) if values else 0.0


def read_recipe(path: Path) -> Recipe:
    """Recipe of a file, with its sensors and its first boxes tried.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Recipe
        The recipe.

    Raises
    ------
    InputError
        If the recipe is faulty, a sensor does not see its wavelengths, or a box cannot be drawn or is dark.
    """
    recipe = load_recipe(path)
    require_format(recipe.picture.format, f"{path}: picture.format")
    for index, sensor in enumerate(recipe.sensor):
        try:
            camera = sensor_camera(sensor, path.parent)
        except InputError as fault:
            raise referred(fault, f"{path}: sensor[{index}].camera") from None
        for channel in camera.channels.values():
            try:
                integration_weights(channel, recipe.picture.wavelength_nm)
            except InputError as fault:
                where = f"{path}: sensor[{index}] ({sensor.camera})"
                raise InputError(where, fault.found, fault.expected, "Widen [picture].") from None
    try:
        for number in range(min(recipe.boxes, _TRIED)):
            _require_light(draw_box(recipe, number, path.parent), recipe)
    except InputError as fault:
        where = str(fault.where).replace("recipe", str(path), 1)
        raise InputError(where, fault.found, fault.expected, fault.hint) from None
    return recipe


def _require_light(box: Box, recipe: Recipe) -> None:
    """Raise InputError for a box whose lamps are dark at all wavelengths of the pictures."""
    grid = recipe.picture.wavelength_nm
    if not box.model.scene.lamp_radiance(grid).any():
        dark = f"{grid[0]:g} to {grid[-1]:g} nm, where the lamps of box {box.number} have no light"
        raise InputError("recipe: picture", dark, "wavelengths in nm at which each lamp shines")


def create_dataset(
    recipe_file: str | Path,
    folder: str | Path,
    workers: Workers = Workers(),
    progress: Progress = NO_PROGRESS,
) -> DatasetRun:
    """Make a data set, or continue one.

    Every picture is written with its truths as soon as it is rendered. A run that was interrupted continues with the
    pictures that are missing; the files are the same, bit by bit, as without an interruption.

    Parameters
    ----------
    recipe_file
        Recipe, TOML.
    folder
        Folder of the data set: new, empty, or begun with the same recipe.
    workers
        Processes that render.
    progress
        Receives the completed share.

    Returns
    -------
    DatasetRun
        The data set and figures of the run.

    Raises
    ------
    InputError
        If the recipe is faulty, the folder holds something else, or no worker answers.
    """
    variant.require_compiled("dataset")
    path, target = required_path("recipe_file", recipe_file, "a recipe (.toml)"), required_folder("folder", folder)
    require_type("workers", workers, Workers, "Workers")
    require_progress(progress)
    begun, begun_cpu = time.monotonic(), _processor_s()
    recipe = read_recipe(path)
    if workers.scheduler is None:
        require_memory(recipe, path, workers.local_cluster or workers.processes)
    layout = begin(recipe, path, target)
    names = camera_names(recipe)
    total = recipe.boxes * len(names)
    tasks = tasks_of(recipe, path, layout)
    numbers = [n for task in tasks for n in task.boxes if n < recipe.boxes]
    pending = {(n, name) for n in numbers for name in names if layout.record(n, name) is None}
    done, seconds, rendering_s, others_s = total - len(pending), 0.0, 0.0, 0.0
    progress.stage("rendering pictures")
    progress.part(done / total)

    def still() -> None:
        progress.part(done / total)

    for record in _records(tasks, workers, still):
        if (record["box"], record["camera"]) in pending:
            done += 1
            seconds += record["seconds"]
            rendering_s += record["rendering_processor_seconds"]
            others_s += record["other_processor_seconds"]
        progress.part(done / total)
    progress.stage("index and quality sheet")
    everything = [layout.record(n, name) for n in range(recipe.boxes) for name in names]
    records = [record for record in everything if record is not None]
    sound = [record for record in records if not record["faults"]]
    write_index(layout, sound)
    write_card(layout, recipe, sound)
    write_croissant(layout, recipe, sound)
    write_sheet(layout, recipe, records)
    elsewhere_s = rendering_s + others_s if workers.scheduler is not None else 0.0
    failed = tuple((f"{r['box']:06d}/{r['camera']}", "; ".join(r["faults"])) for r in records if r["faults"])
    return DatasetRun(
        dataset=open_dataset(target),
        rendered=len(pending),
        reused=total - len(pending),
        seconds=time.monotonic() - begun,
        picture_seconds=seconds,
        rendering_processor_seconds=rendering_s,
        processor_seconds=_processor_s() - begun_cpu + elsewhere_s,
        failed=failed,
    )


def _processor_s() -> float:
    """Processor time of this process and of those that it started and that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _records(tasks: list[Task], workers: Workers, still: Any) -> Iterator[dict[str, Any]]:
    """Records of the pictures of tasks, in the order of their ends."""
    if workers.scheduler is not None:
        groups: Iterator[list[dict[str, Any]]] = on_scheduler(tasks, workers.scheduler, still)
    elif workers.local_cluster is not None:
        groups = on_local_cluster(tasks, workers.local_cluster, still)
    elif workers.processes > 1:
        groups = in_processes(tasks, workers.processes, still)
    else:
        for task in tasks:
            yield from pictures_of(task)
        return
    for group in groups:
        yield from group
