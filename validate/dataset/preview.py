"""Preview of a recipe: thumbnails, distributions, and the cost of the whole set."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from cboxlab.rendering.dataset import Recipe, draw_box, sharing_rays
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_passes
from cboxlab.rendering.model import labelled_cube, model_cube_inputs
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import temporary_folder
from cboxlab.utils.progress import NO_PROGRESS, Progress

from .create import read_recipe
from .formats import PICTURE_ENDINGS, write_picture
from .memory import require_memory
from .picture import render_pictures
from .sheet import drawn_values, histograms, thumbnail, write_page
from .tasks import block_of, camera_names

__all__ = ["Preview", "preview_recipe"]

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
    #: Time of one picture in one process of this machine, s.
    seconds_each: float
    #: Size of one picture on disk, bytes.
    bytes_each: int
    #: Draws that were rejected, by box.
    rejected: float

    def lines(self) -> list[str]:
        """Sentences about the cost.

        Returns
        -------
        list of str
            Time and size of the whole set first.
        """
        hours = self.pictures * self.seconds_each / _HOUR_S
        return [
            f"{self.pictures} pictures: about {hours:.2g} h in one process on this machine, "
            f"{self.pictures * self.bytes_each / 1e9:.2g} GB ({self.seconds_each:.1f} s and "
            f"{self.bytes_each / 1e6:.1f} MB each)",
            f"{self.rejected:.2g} rejected draws for each box",
        ]


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
    progress.stage("measuring one picture")
    names = camera_names(recipe)
    seconds, size = _cost(recipe, path.parent, names)
    rejected = sum(sum(box.record["rejected"].values()) for box in boxes) / len(boxes)
    count = recipe.boxes * len(names)
    preview = Preview(Path(page), count, seconds, size, rejected)
    plots = [("Distributions", histograms(drawn_values([box.record for box in boxes])))]
    write_page(Path(page), f"Preview of {recipe.name}", preview.lines(), pictures, plots)
    progress.part(1.0)
    return preview


def _cost(recipe: Recipe, folder: Path, names: list[str]) -> tuple[float, int]:
    """Mean time of a picture, s, and the size of one, bytes, over a block of boxes.

    Pictures of the first block compile kernels. Those of the next one are measured; a further camera uses the solution
    of the first one, so the second stands for all of them.
    """
    first = block_of(recipe, 0)
    blocks, spent, size = [first, block_of(recipe, first.stop)], [0.0, 0.0], 0
    with temporary_folder() as target:
        for block in blocks:
            groups = sharing_rays([draw_box(recipe, number, folder) for number in block])
            for index, name in enumerate(names[: len(spent)]):
                begun = time.monotonic()
                for group in groups if block is not first else groups[:1]:
                    for cube in render_pictures(group, name, recipe, folder):
                        file = target / f"picture{PICTURE_ENDINGS[recipe.picture.format]}"
                        write_picture(file, cube)
                        size = file.stat().st_size
                spent[index] = time.monotonic() - begun
    cameras = spent[0] + (len(names) - 1) * spent[1]
    return cameras / len(names) / len(blocks[1]), size


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
