"""Patterns: tiles of a wall in their places, exact albedo, and the light that an unbiased path tracer finds."""

import numpy as np
import pytest
from cboxlab.rendering.dataset import draw_box, light_parts, load_recipe, visible_points
from cboxlab.rendering.dataset.patterns import drawn_tiles, tiled
from cboxlab.rendering.dataset.solids import Solid
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image, render_passes
from cboxlab.rendering.model import load_model, write_model
from cboxlab.utils.errors import InputError
from helpers.scenes.recipes import write_recipe
from PIL import Image

GRID = np.array([450.0, 550.0, 650.0])

#: A checkered floor, and a back wall of the pixels of an image.
PATTERNS = (
    '[walls]\nfloor = "light"\nceiling = "light"\nback = "light"',
    """[pattern.checks]
paints = ["light", "colour"]
rows = 3
columns = 5
[pattern.pixels]
kind = "image"
paints = ["colour", "light"]
image = "tiles.png"
[walls]
floor = "checks"
ceiling = "light"
back = "pixels\"""",
)

#: A block with the pattern of the floor on its sides.
TILED_BLOCK = ('height_mm = [80, 300]\npaint = "light"', 'height_mm = [80, 300]\npaint = "checks"')

#: Grey levels of the image: the darkest is the first paint of its pattern.
LEVELS = np.array([[10, 200, 200], [200, 10, 10]], np.uint8)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    folder = tmp_path_factory.mktemp("patterns")
    Image.fromarray(LEVELS).save(folder / "tiles.png")
    larger = [(f"{side}_px = 16", f"{side}_px = 24") for side in ("width", "height")]
    path = write_recipe(folder, TILED_BLOCK, PATTERNS, ("seed = 11", "seed = 14"), *larger)
    recipe = load_recipe(path)
    assert recipe.files == ["tiles.png"]
    return draw_box(recipe, 0, folder)


def test_tiles_fill_their_wall_and_face_inwards():
    """Areas sum to the wall's for any numbers; the first row is the upper one, the first column the left one."""
    corners = np.array([[0.0, 0, 0], [7, 0, 0], [7, 3, 0], [0, 3, 0]])
    tiles = drawn_tiles("random", (4, 6), 3, np.random.default_rng(2)).astype(str)
    surfaces = tiled("back", [(corners, tiles)])
    assert [s.name for s in surfaces] == ["back-0", "back-1", "back-2"]
    for surface in surfaces:
        assert surface.areas_mm2.sum() == pytest.approx(21 * np.mean(tiles == surface.material))
        centre = surface.vertices_mm.reshape(-1, 4, 3).mean(axis=1)
        column, row = (centre[:, 0] / 7 * 6).astype(int), ((1 - centre[:, 1] / 3) * 4).astype(int)
        assert (tiles[row, column] == surface.material).all()
        corner = surface.vertices_mm[surface.faces]
        assert (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0).all()
    np.testing.assert_array_equal(drawn_tiles("stripes", (2, 3), 2, np.random.default_rng(0)), [[0, 1, 0]] * 2)


def test_tiles_of_a_block_cover_its_mesh(box):
    """Area, closedness, volume and outward faces are those of the plain block; each side has its own drawn tiles."""
    record = box.record["blocks"][0]
    surfaces = [surface for surface in box.model.scene.surfaces if surface.name.startswith("1-block-")]
    assert [surface.material for surface in surfaces] == ["colour", "light"]
    corners = np.concatenate([surface.vertices_mm[surface.faces] for surface in surfaces])
    width, height, depth = record["size_mm"]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * (width * height + height * depth + depth * width))
    centred = corners - record["center_mm"]
    assert np.linalg.det(centred).sum() / 6 == pytest.approx(width * height * depth)
    assert (np.linalg.det(centred) > 0).all()  # the centre is behind every face
    plain = Solid(np.array(record["center_mm"]), np.array(record["size_mm"]) / 2, record["yaw_deg"]).mesh[0]
    np.testing.assert_allclose(np.ptp(corners.reshape(-1, 3), axis=0), np.ptp(plain, axis=0))
    assert np.shape(record["tiles"]["top"]) == (3, 5) and record["tiles"]["bottom"] == [["light"]]


def test_a_box_of_patterns_is_drawn_written_and_read_again(box, tmp_path):
    assert box.record["walls"]["back"] == "pixels"
    assert box.record["tiles"]["back"] == [["colour", "light", "light"], ["light", "colour", "colour"]]
    assert np.unique(box.record["tiles"]["floor"], return_counts=True)[1].tolist() == [7, 8]
    write_model(tmp_path / "model.toml", box.model)
    for mine, other in zip(load_model(tmp_path / "model.toml").scene.surfaces, box.model.scene.surfaces, strict=True):
        assert (mine.name, mine.material) == (other.name, other.material)
        np.testing.assert_array_equal(mine.vertices_mm, other.vertices_mm)


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")
def test_the_albedo_of_tiles_is_exact_and_their_light_unbiased(box):
    """Albedo by each point's tile, to single precision; light within four standard errors of the path tracer's."""
    scene, camera = box.model.scene, box.cameras["main"]
    image = render_passes(RenderJob(scene, camera, GRID, 64, 8, seed=3))
    points, parts, mean = visible_points(scene, camera), light_parts(image, scene), image.mean(np.eye(3))
    width, height, _ = box.record["room_mm"]
    back = np.array([surface.name.startswith("back") for surface in scene.surfaces] + [False])
    shares = np.stack([image.coverage[..., image.facet_surface == s].sum(axis=-1) for s in range(len(back))], axis=-1)
    alone = (shares.max(axis=-1) > 1 - 1e-6) & back[points.surface]
    x, y = points.position_mm[alone][:, 0] / width, points.position_mm[alone][:, 1] / height
    tiles = np.array(box.record["tiles"]["back"])[(2 * (1 - y)).astype(int), (3 * (1 - x)).astype(int)]
    expected = scene.reflectances(GRID)[[list(scene.materials).index(name) for name in tiles]]
    assert alone.sum() > 15 and len(np.unique(tiles)) == 2
    np.testing.assert_allclose(parts.albedo[alone], expected, atol=1e-6)
    product = (parts.albedo * parts.irradiance / np.pi)[alone]
    np.testing.assert_allclose(product, (mean - parts.reflections[0])[alone], atol=1e-6 * mean.max())
    other = render_image(RenderJob(scene, camera, GRID, 64, 16, seed=8), integrator="path")
    tiled_ones = [s.name.startswith(("back", "floor", "1-block")) for s in scene.surfaces]
    assert sum(tiled_ones) == 6
    for surface in np.flatnonzero(tiled_ones):
        on = image.surface == surface
        assert on.sum() > 4
        batches = [[(c[on].mean(axis=0) @ i.spectra) for c in i.coefficients] for i in (image, other)]
        errors = [np.std(each, axis=0, ddof=1) / np.sqrt(len(each)) for each in batches]
        difference = np.mean(batches[0], axis=0) - np.mean(batches[1], axis=0)
        assert (np.abs(difference) < 4 * np.hypot(*errors) + 1e-3 * np.mean(batches[1], axis=0)).all()


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (('"tiles.png"', '"none.png"'), "pattern.pixels.image"),
        (('paints = ["colour", "light"]', 'paints = ["colour", "pixels"]'), "pattern.pixels.paints: found 'pixels'"),
        (('image = "tiles.png"\n', ""), "without an image"),
        (('ceiling = "light"', 'ceiling = "checks"'), "walls.ceiling: found 'checks'"),
        (("rows = 3", "rows = 33"), "pattern.checks.rows"),
        (("rows = 3", "rows = 9"), "block[0].paint: found the pattern 'checks' of up to 9 tiles"),
        (("[pattern.checks]", "[pattern.light]"), "the name of a paint"),
    ],
)
def test_a_faulty_pattern_is_refused_with_its_key(tmp_path, change, phrase):
    Image.fromarray(LEVELS).save(tmp_path / "tiles.png")
    with pytest.raises(InputError) as raised:
        load_recipe(write_recipe(tmp_path, TILED_BLOCK, PATTERNS, change))
    assert phrase in str(raised.value)


def test_an_image_has_one_grey_level_for_each_paint(tmp_path):
    Image.fromarray(LEVELS + np.arange(3, dtype=np.uint8)).save(tmp_path / "tiles.png")
    with pytest.raises(InputError, match="grey levels in tiles"):
        load_recipe(write_recipe(tmp_path, PATTERNS))
