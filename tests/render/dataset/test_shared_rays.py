"""Boxes of one geometry that share rays: each gets the light that it has alone."""

import numpy as np
import pytest
from cboxlab.rendering.dataset import draw_box, joined_scene, load_recipe, sharing_rays, split_image
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import relative_error, render_passes, render_to_precision
from helpers.scenes.recipes import write_recipe

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators"),
    pytest.mark.usefixtures("large_patches"),
]

GRID = np.arange(400.0, 701.0, 60.0)

#: Three boxes of one geometry; some of them have another room, by an effect.
RECIPE = (
    ("boxes = 2", "boxes = 3\nboxes_per_geometry = 3"),
    ("[room]", '[[effect]]\nid = "block-pose"\nblock = "any"\ndx_mm = 8\nprobability = 0.4\n[room]'),
)


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    recipe = load_recipe(write_recipe(folder, RECIPE[0]))
    return [draw_box(recipe, number, folder) for number in range(3)]


@pytest.fixture(scope="module")
def scenes(boxes):
    return [box.model.scene for box in boxes]


def test_boxes_of_other_geometry_have_their_own_rays(tmp_path):
    recipe = load_recipe(write_recipe(tmp_path, *RECIPE))
    boxes = [draw_box(recipe, number, tmp_path) for number in range(24)]
    for geometry in range(8):
        groups = sharing_rays(boxes[3 * geometry :][:3])
        assert sorted(box.number for group in groups for box in group) == list(range(3 * geometry, 3 * geometry + 3))
        assert all(len(group) == 1 for group in groups if any(box.model.effects for box in group))
    assert {bool(box.model.effects) for box in boxes} == {True, False}


def test_each_box_has_the_light_that_it_has_alone(boxes, scenes):
    """The same rays alone: what remains is the accuracy of the two bases, a tenth of a percent of each pixel."""
    camera = boxes[0].cameras["main"]
    joined, grid = joined_scene(scenes, GRID)
    together = split_image(render_passes(RenderJob(joined, camera, grid, 64, 2, seed=3)), 3, GRID)
    for scene, image in zip(scenes[1:2], together[1:2], strict=True):
        alone = render_passes(RenderJob(scene, camera, GRID, 64, 2, seed=3))
        every = np.eye(GRID.size)
        difference = image.mean(every) - alone.mean(every)
        size = alone.mean(every)[alone.sees_surfaces].mean()
        variance = image.project(every)[1] + alone.project(every)[1]
        assert abs(difference.mean()) < 1e-3 * size
        assert np.mean(difference**2) < np.mean(variance)
        np.testing.assert_array_equal(image.coverage, alone.coverage)


def test_every_box_reaches_the_stated_error(boxes, scenes):
    joined, grid = joined_scene(scenes, GRID)
    job = RenderJob(joined, boxes[0].cameras["main"], grid, seed=3)
    image = render_to_precision(job, 0.015, pictures=3)
    assert max(relative_error(part) for part in split_image(image, 3, GRID)) <= 0.015
