"""Tasks of a data set: a few boxes of one geometry each, rendered to files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.dataset import Box, Recipe, draw_box, load_recipe, sharing_rays
from cboxlab.rendering.model import write_model

from .checks import check_picture
from .formats import COPY_ENDINGS, PICTURE_ENDINGS, write_copy, write_picture
from .layout import Layout, file_hash, write_json
from .picture import mean_spectrum, render_pictures, visible_weights

__all__ = ["MOST_BOXES", "Task", "block_of", "camera_names", "run_task", "tasks_of"]

#: Most boxes of a task, which may share rays: a task of a minute is repeated where its worker ends.
MOST_BOXES = 8

#: Decimals of a figure in a record.
_DIGITS = 6


@dataclass(frozen=True)
class Task:
    """Some boxes of one geometry."""

    #: File of the recipe.
    recipe: str
    #: Folder of the data set.
    folder: str
    #: Numbers of the boxes, a whole block (``block_of``).
    boxes: tuple[int, ...]


def camera_names(recipe: Recipe) -> list[str]:
    """Names of the cameras of every box.

    Parameters
    ----------
    recipe
        The recipe.

    Returns
    -------
    list of str
        Names in their order; those of a grid have row and column, from 1.
    """
    names = []
    for table in recipe.camera:
        alone = table.across == table.down == 1
        grid = [(row + 1, column + 1) for row in range(table.down) for column in range(table.across)]
        names += [table.name if alone else f"{table.name}-{row}-{column}" for row, column in grid]
    return names


def block_of(recipe: Recipe, number: int) -> range:
    """Boxes of one geometry that are rendered together.

    A block does not depend on the number of boxes of the set: a larger set begins like a smaller one.

    Parameters
    ----------
    recipe
        The recipe.
    number
        Number of a box.

    Returns
    -------
    range
        Numbers of the boxes of its block; some may lie beyond the set.
    """
    geometry, variant = divmod(number, recipe.boxes_per_geometry)
    first = geometry * recipe.boxes_per_geometry
    start = first + variant - variant % MOST_BOXES
    return range(start, min(start + MOST_BOXES, first + recipe.boxes_per_geometry))


def tasks_of(recipe: Recipe, recipe_file: Path, layout: Layout) -> list[Task]:
    """Tasks that remain: blocks of boxes without a complete picture by each camera.

    Parameters
    ----------
    recipe
        The recipe.
    recipe_file
        Its file.
    layout
        Files of the data set.

    Returns
    -------
    list of Task
        Tasks in the order of the boxes.
    """
    names, tasks = camera_names(recipe), []
    source, target = str(recipe_file.resolve()), str(layout.folder.resolve())
    number = 0
    while number < recipe.boxes:
        block = block_of(recipe, number)
        in_set = range(number, min(block.stop, recipe.boxes))
        if any(layout.record(n, name) is None for n in in_set for name in names):
            tasks.append(Task(source, target, tuple(block)))
        number = block.stop
    return tasks


@lru_cache(maxsize=4)
def _recipe(path: str, _changed: float) -> Recipe:
    """Recipe of a file, kept for the next task."""
    return load_recipe(Path(path))


def run_task(task: Task) -> list[dict[str, Any]]:
    """Render the missing pictures of a task.

    Parameters
    ----------
    task
        The task.

    Returns
    -------
    list of dict
        Records of its pictures, rendered now or before.
    """
    return list(pictures_of(task))


def pictures_of(task: Task) -> Iterator[dict[str, Any]]:
    """Pictures of a task, one after another.

    Parameters
    ----------
    task
        The task.

    Yields
    ------
    dict
        Record of each picture, which is complete on disk.
    """
    path, clock = Path(task.recipe), _Clock()
    recipe = _recipe(task.recipe, path.stat().st_mtime)
    layout = Layout(Path(task.folder))
    for group in sharing_rays([draw_box(recipe, number, path.parent) for number in task.boxes]):
        for name in camera_names(recipe):
            numbers = [box.number for box in group if box.number < recipe.boxes]
            records = {number: layout.record(number, name) for number in numbers}
            if all(record is not None for record in records.values()):
                yield from (record for record in records.values() if record is not None)
                continue
            pictures = _one_thread(render_pictures(group, name, recipe, path.parent), clock)
            for box, cube in zip(group, pictures, strict=True):
                if box.number in records:
                    yield records[box.number] or _stored(cube, box, name, recipe, layout, clock)


class _Clock:
    """Time of a task since its last picture."""

    def __init__(self) -> None:
        self._begun, self._begun_cpu, self.rendering_s = time.monotonic(), time.process_time(), 0.0

    def rendered(self, seconds: float) -> None:
        """Count processor time as that of rendering."""
        self.rendering_s += seconds

    def seconds(self) -> dict[str, float]:
        """Times of a picture that ends now, for its record."""
        spent, cpu, rendering = time.monotonic(), time.process_time(), self.rendering_s
        record = {
            "seconds": spent - self._begun,
            "rendering_processor_seconds": rendering,
            "other_processor_seconds": cpu - self._begun_cpu - rendering,
        }
        self._begun, self._begun_cpu, self.rendering_s = spent, cpu, 0.0
        return {name: round(value, 3) for name, value in record.items()}


def _one_thread(pictures: Iterator[xr.Dataset], clock: _Clock) -> Iterator[xr.Dataset]:
    """The pictures, with linear algebra in one thread.

    Sums over several threads round differently, and a picture has the same bits on any number of processors.
    """
    from threadpoolctl import threadpool_limits  # sets an environment variable when imported

    while True:
        begun = time.process_time()
        with threadpool_limits(1):
            picture = next(pictures, None)
        clock.rendered(time.process_time() - begun)
        if picture is None:
            return
        yield picture


def _stored(cube: xr.Dataset, box: Box, camera: str, recipe: Recipe, layout: Layout, clock: _Clock) -> dict[str, Any]:
    """Record of a picture that is checked and written; boxes that fail are kept apart."""
    checks = check_picture(cube, box, recipe.picture.noise, recipe.picture.mantissa_bits)
    target = layout.box(box.number, bool(checks.faults))
    target.mkdir(parents=True, exist_ok=True)
    if not (target / "box.json").exists():
        write_model(target / "model.toml", box.model)
        write_json(target / "box.json", box.record)
    file = target / f"{camera}{PICTURE_ENDINGS[recipe.picture.format]}"
    write_picture(file, cube)
    for kind in recipe.picture.copies:
        write_copy(target / f"{camera}{COPY_ENDINGS[kind]}", cube)
    spectrum = mean_spectrum(cube)
    luminance = spectrum @ visible_weights(cube["wavelength"].values)[:, 1]
    record = {
        "box": box.number,
        "geometry": box.record["geometry"],
        "camera": camera,
        "part": box.part,
        "file": file.relative_to(layout.folder).as_posix(),
        "model": (target / "model.toml").relative_to(layout.folder).as_posix(),
        "relative_standard_error": float(f"{cube.attrs['relative_standard_error']:.{_DIGITS}g}"),
        "mean_luminance": float(f"{luminance:.{_DIGITS}g}"),
        "mean_spectrum": [float(f"{value:.{_DIGITS}g}") for value in spectrum],
        "effects": cube.attrs["effects"],
        "faults": list(checks.faults),
        "figures": {k: None if np.isnan(v) else float(f"{v:.{_DIGITS}g}") for k, v in checks.figures.items()},
        "bytes": file.stat().st_size,
        "sha256": file_hash(file),
        **clock.seconds(),
    }
    layout.store(box.number, camera, record)
    return record
