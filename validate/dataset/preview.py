"""Preview of a recipe: thumbnails, distributions, and the cost of the whole set."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.dataset import Box, Recipe, draw_box, sharing_rays
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_passes
from cboxlab.rendering.model import labelled_cube, model_cube_inputs
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import temporary_folder
from cboxlab.utils.progress import NO_PROGRESS, Progress

from .checks import check_picture
from .create import read_recipe
from .formats import PICTURE_ENDINGS, write_picture
from .memory import require_memory
from .picture import render_pictures
from .sheet import drawn_values, histograms, thumbnail, write_page
from .tasks import block_of, camera_names

__all__ = ["Preview", "preview_recipe"]

#: Blocks of boxes that are measured, of those with effects on light transport and of those without.
_MEASURED = 2

#: Boxes with thumbnails.
_THUMBNAILS = 20

#: Boxes whose values the distributions show.
_DRAWN = 200

#: Width of a thumbnail, px.
_WIDTH_PX = 48

#: Samples of a pixel of a thumbnail.
_SAMPLES = 16

#: Wavelengths of a thumbnail at most.
_WAVELENGTHS = 16

#: Seconds of an hour.
_HOUR_S = 3600.0


@dataclass(frozen=True)
class Preview:
    """Pictures and cost of a recipe."""

    #: The page with thumbnails and distributions.
    page: Path
    #: Number of pictures of the whole set.
    pictures: int
    #: Processor time of one picture, over all threads, s.
    seconds_each: float
    #: Content of a picture.
    kind: str
    #: Size of one picture on disk, bytes.
    bytes_each: int
    #: Draws that were rejected, by box.
    rejected: float

    def lines(self) -> list[str]:
        """Sentences about the cost.

        Returns
        -------
        list of str
            Time of the whole set first, then its size.
        """
        hours, cores = self.pictures * self.seconds_each / _HOUR_S, os.cpu_count() or 1
        return [
            f"{self.pictures} pictures, {self.kind}: about {_span(hours / cores)} on the {cores} cores of this machine "
            f"by as many processes ({hours:.2g} core hours, {self.seconds_each:.1f} s each)",
            f"{self.pictures * self.bytes_each / 1e9:.2g} GB ({self.bytes_each / 1e6:.1f} MB each)",
            f"{self.rejected:.2g} rejected draws for each box",
        ]


def _span(hours: float) -> str:
    """Text of a time in hours, minutes or seconds, to two digits."""
    units = (("h", 1.0), ("min", 60.0), ("s", _HOUR_S))
    unit, part = next(((unit, part) for unit, part in units if hours * part >= 1), units[-1])
    return f"{float(f'{hours * part:.2g}'):g} {unit}"


def preview_recipe(recipe_file: str | Path, page: str | Path, progress: Progress = NO_PROGRESS) -> Preview:
    """Write a page with thumbnails and distributions, and measure the cost of one picture.

    Parameters
    ----------
    recipe_file
        Recipe, TOML.
    page
        File of the page, HTML.
    progress
        Receives the completed share.

    Returns
    -------
    Preview
        The page and the cost.

    Raises
    ------
    InputError
        If the recipe is faulty, or a box cannot be drawn.
    """
    path = Path(recipe_file)
    recipe = read_recipe(path)
    require_memory(recipe, path, 1)
    progress.stage("drawing boxes")
    boxes = [draw_box(recipe, number, path.parent) for number in range(min(recipe.boxes, _DRAWN))]
    progress.stage("rendering thumbnails")
    grid = recipe.picture.wavelength_nm[:: max(1, -(-recipe.picture.wavelength_nm.size // _WAVELENGTHS))]
    pictures = []
    first = boxes[:_THUMBNAILS]
    for number, box in enumerate(first):
        name, camera = next(iter(box.cameras.items()))
        scene, moved, bounces = model_cube_inputs(box.model, _smaller(camera))
        job = RenderJob(scene, moved, grid, samples=_SAMPLES, batches=1, seed=box.seed, max_bounces=bounces)
        pictures.append((f"{box.number:06d} {name}", thumbnail(labelled_cube(render_passes(job)))))
        progress.part((number + 1) / (len(first) + 1))
    progress.stage("measuring pictures")
    names = camera_names(recipe)
    seconds, size = _cost(recipe, path.parent, boxes)
    rejected = sum(sum(box.record["rejected"].values()) for box in boxes) / len(boxes)
    count = recipe.boxes * len(names)
    sizes = {f"{camera.width_px} x {camera.height_px}" for camera in recipe.camera}
    kind = f"{recipe.picture.wavelength_nm.size} wavelengths, {' and '.join(sorted(sizes))}"
    preview = Preview(Path(page), count, seconds, kind, size, rejected)
    plots = [("Distributions", histograms(drawn_values([box.record for box in boxes])))]
    write_page(Path(page), f"Preview of {recipe.name}", preview.lines(), pictures, plots)
    progress.part(1.0)
    return preview


def _cost(recipe: Recipe, folder: Path, boxes: list[Box]) -> tuple[float, int]:
    """Mean processor time of a picture, s, and mean size of one, bytes.

    Blocks of boxes with effects on light transport and blocks without are measured apart, and weighted by their shares
    of the drawn boxes: gloss doubles the cost. The first block of each kind compiles kernels, which a long run does
    once.
    """
    blocks: dict[bool, dict[range, None]] = {False: {}, True: {}}
    with_effects = {block_of(recipe, box.number) for box in boxes if _has_effects(box)}
    for box in boxes:
        block = block_of(recipe, box.number)
        blocks[block in with_effects][block] = None
    total = sum(map(len, blocks.values()))
    seconds, size = 0.0, 0.0
    for kind in blocks.values():
        costs = [_block_cost(recipe, folder, block) for block in list(kind)[: 1 + _MEASURED]]
        for cost, bytes_each in costs[1:] or costs:
            share_of_all = len(kind) / total / len(costs[1:] or costs)
            seconds, size = seconds + share_of_all * cost, size + share_of_all * bytes_each
    return seconds, round(size)


def _has_effects(box: Box) -> bool:
    """Whether a box has an effect on light transport."""
    return any(effect.stage == "transport" for effect in box.model.effects)


def _block_cost(recipe: Recipe, folder: Path, block: range) -> tuple[float, float]:
    """Mean processor time of a block's pictures, s, and their mean size, bytes.

    A further camera uses the solution of the first one, so the second stands for all of them.
    """
    names, spent, sizes = camera_names(recipe), [0.0, 0.0], []
    groups = sharing_rays([draw_box(recipe, number, folder) for number in block])
    with temporary_folder() as target:
        file = target / f"picture{PICTURE_ENDINGS[recipe.picture.format]}"
        for index, name in enumerate(names[: len(spent)]):
            begun = time.process_time()
            for group in groups:
                for box, cube in zip(group, render_pictures(group, name, recipe, folder), strict=True):
                    check_picture(cube, box, recipe.picture.noise, recipe.picture.mantissa_bits)
                    write_picture(file, cube)
                    sizes.append(file.stat().st_size)
            spent[index] = time.process_time() - begun
    return (spent[0] + (len(names) - 1) * spent[1]) / len(names) / len(block), float(np.mean(sizes))


def _smaller(camera: Camera) -> Camera:
    """Camera of the same view with fewer pixels."""
    factor = min(1.0, _WIDTH_PX / camera.width_px)
    width, height = (max(8, round(factor * side)) for side in (camera.width_px, camera.height_px))
    return replace(
        camera,
        width_px=width,
        height_px=height,
        focal_length_px=camera.focal_length_px * factor,
        principal_point_px=(camera.principal_point_px + 0.5) * factor - 0.5,
    )
