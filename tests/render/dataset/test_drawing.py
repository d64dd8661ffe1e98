"""Drawn boxes: what a recipe allows, the same again by seed and number, and nothing that intersects."""

import numpy as np
import pytest
import trimesh
from cboxlab.rendering.dataset import draw_box, load_recipe, part_of
from cboxlab.rendering.dataset.distributions import numbers
from cboxlab.rendering.dataset.drawing import _Rectangle
from cboxlab.rendering.dataset.solids import Solid, any_meet, blocked_share
from cboxlab.utils.errors import InputError
from helpers.places import ROOT
from helpers.scenes.recipes import write_recipe


def samples_of(value, count=4000):
    distribution, generator = numbers(value), np.random.default_rng(1)
    return np.array([distribution.draw(generator) for _ in range(count)])


def test_distributions_have_their_moments():
    """Means within five standard errors of the exact ones."""
    cases = [
        ([2.0, 4.0], 3.0, 2 / np.sqrt(12)),
        ({"log_uniform": [1.0, np.e]}, np.e - 1, np.sqrt((np.e**2 - 1) / 2 - (np.e - 1) ** 2)),
        ({"normal": [5.0, 2.0]}, 5.0, 2.0),
        ({"integer": [1, 3]}, 2.0, np.sqrt(2 / 3)),
        ({"choice": [0, 10], "weights": [3, 1]}, 2.5, np.sqrt(0.75 * 0.25) * 10),
    ]
    for value, mean, sigma in cases:
        values = samples_of(value)
        assert abs(values.mean() - mean) < 5 * sigma / np.sqrt(len(values))
        low, high = numbers(value).support
        assert low <= values.min() and values.max() <= high


@pytest.mark.parametrize(
    "value",
    [
        "3",
        [1, 2, 3],
        [2, 1],
        {"uniform": [1, 2], "integer": [1, 2]},
        {"log_uniform": [0, 1]},
        {"integer": [0.5, 2]},
        {"normal": [4000, 1], "within": [6000, 6500]},
        {"normal": [400, 0], "within": [6000, 6500]},
        True,
    ],
)
def test_values_that_are_no_distribution_are_refused(value):
    with pytest.raises(ValueError, match=r"."):
        numbers(value)


def test_a_box_depends_on_its_number_and_seed_alone(tmp_path):
    recipe = load_recipe(write_recipe(tmp_path))
    larger = load_recipe(write_recipe(tmp_path, ("boxes = 2", "boxes = 20")))
    again = draw_box(larger, 1, tmp_path)
    assert draw_box(recipe, 1, tmp_path).record == again.record
    assert recipe.digest(tmp_path) == larger.digest(tmp_path)
    other = load_recipe(write_recipe(tmp_path, ("seed = 11", "seed = 12")))
    assert draw_box(other, 1, tmp_path).record != again.record


def test_drawn_boxes_hold_what_the_recipe_allows(tmp_path):
    recipe = load_recipe(write_recipe(tmp_path))
    powers = []
    for number in range(12):
        box = draw_box(recipe, number, tmp_path)
        width = box.record["room_mm"][0]
        assert 450 <= width <= 650
        scene = box.model.scene
        floor = scene.surface("floor").vertices_mm
        np.testing.assert_allclose(np.ptp(floor[:, 0]), width)
        area_m2 = scene.lamp.surface.areas_mm2.sum() * 1e-6
        grid = np.arange(400.0, 701.0)
        power = np.pi * area_m2 * np.trapezoid(scene.lamp.radiance.at(grid), grid)
        np.testing.assert_allclose(power, box.record["lamps"][0]["power_w"], rtol=1e-9)
        powers.append(power)
        assert box.part == part_of(recipe, number)
        for name, entry in box.record["paints"].items():
            assert scene.materials[name].reflectance.values.max() <= 1 + 1e-12
            assert entry["reflectance"].split(":")[0] in ("cornell-box", "colorchecker", "cie-224")
    assert 0.5 <= min(powers) < max(powers) <= 5.0


def test_boxes_of_one_geometry_differ_in_spectra_alone_and_share_a_part(tmp_path):
    recipe = load_recipe(write_recipe(tmp_path, ("boxes = 2", "boxes = 6\nboxes_per_geometry = 3")))
    boxes = [draw_box(recipe, number, tmp_path) for number in range(6)]
    for first in (0, 3):
        same = boxes[first : first + 3]
        assert len({box.seed for box in same}) == len({box.part for box in same}) == 1
        for box in same[1:]:
            for mine, other in zip(box.model.scene.all_surfaces, same[0].model.scene.all_surfaces, strict=True):
                np.testing.assert_array_equal(mine.vertices_mm, other.vertices_mm)
        assert len({box.record["lamps"][0]["power_w"] for box in same}) == 3
    assert boxes[0].seed != boxes[3].seed


def test_a_mesh_stands_on_the_floor_in_its_height(tmp_path):
    """A cone of a file, scaled and turned: bounds and volume as drawn; one with a hole is refused."""
    cone = trimesh.creation.cone(radius=0.5, height=2.0, sections=12)
    cone.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y upwards
    cone.export(tmp_path / "cone.stl")
    mesh = (
        'height_mm = [80, 300]\npaint = "light"',
        'shape = "mesh"\nmesh = "cone.stl"\nheight_mm = 120\npaint = "light"',
    )
    path = write_recipe(tmp_path, mesh)
    recipe = load_recipe(path)
    assert recipe.files == ["cone.stl"]
    box = draw_box(recipe, 0, tmp_path)
    surface = next(s for s in box.model.scene.surfaces if s.name.endswith("mesh"))
    drawn_mesh = trimesh.Trimesh(surface.vertices_mm, surface.faces)
    assert drawn_mesh.is_watertight and drawn_mesh.bounds[0, 1] == pytest.approx(0, abs=1e-6)
    assert np.ptp(drawn_mesh.bounds[:, 1]) == pytest.approx(120)
    assert drawn_mesh.volume == pytest.approx(cone.volume * 60**3, rel=1e-5)
    assert box.record["blocks"][0]["shape"] == "mesh"
    cone.update_faces(np.arange(len(cone.faces)) > 0)
    cone.export(tmp_path / "cone.obj")
    with pytest.raises(InputError, match="holes"):
        load_recipe(write_recipe(tmp_path, (mesh[0], mesh[1].replace("stl", "obj"))))
    with pytest.raises(InputError, match="without a mesh"):
        load_recipe(write_recipe(tmp_path, (mesh[0], mesh[1].replace('mesh = "cone.stl"', ""))))


def test_the_published_camera_is_drawn_from_its_figures(tmp_path):
    """Axes as those of REFERENCE_ROTATION for a camera that looks along the room; a point off its axis to the left."""
    recipe = load_recipe(
        write_recipe(tmp_path, ("width_mm = [450, 650]", "width_mm = 556"), ("k1 = [-0.05, 0.05]", ""))
    )
    camera = draw_box(recipe, 0, tmp_path).cameras["main"]
    np.testing.assert_allclose(camera.rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    middle = camera.project([[278.0, 274.4, 100.0], [400.0, 274.4, 100.0]])
    np.testing.assert_allclose(middle[0], [7.5, 7.5])
    assert middle[1, 0] < 7.5  # +x is to the left of the camera


def test_a_grid_of_cameras_is_a_row_along_the_cameras_axis(tmp_path):
    change = ("width_px = 16", "width_px = 16\nacross = 2\nspacing_mm = 65.0\nroll_deg = 20")
    recipe = load_recipe(write_recipe(tmp_path, change))
    left, right = draw_box(recipe, 0, tmp_path).cameras.values()
    np.testing.assert_allclose(left.rotation @ (right.position_mm - left.position_mm), [65.0, 0, 0], atol=1e-9)


def test_solids_that_meet_are_those_whose_meshes_do():
    """Against points inside of each other's meshes, for many pairs of blocks and spheres."""
    generator, agreed, meeting = np.random.default_rng(4), 0, 0
    for _ in range(150):
        pair = []
        for _ in range(2):
            ball = bool(generator.random() < 0.4)
            half = np.full(3, generator.uniform(20, 60)) if ball else generator.uniform(20, 80, 3)
            x, z = generator.uniform(0, 220, 2)
            pair.append(Solid(np.array([x, half[1], z]), half, 0.0 if ball else generator.uniform(0, 90), ball))
        inside = [_depth(pair[1 - i], _points(solid, generator)).max() for i, solid in enumerate(pair)]
        if abs(max(inside)) < 3.0:  # too close for points on the surfaces to decide
            continue
        meets = max(inside) > 0
        assert any_meet(pair, 0.0) == meets
        agreed, meeting = agreed + 1, meeting + meets
    assert agreed > 60 and 10 < meeting < agreed - 10


def _points(solid, generator):
    """Points of a solid, as mixtures of the vertices of its mesh."""
    vertices = solid.mesh[0]
    some = vertices[generator.integers(len(vertices), size=(1000, 4))]
    shares = generator.dirichlet(np.full(4, 0.3), size=1000)
    return np.concatenate([vertices, np.einsum("nk,nki->ni", shares, some)])


def _depth(solid, points):
    """Depth of points below the nearest face of a solid's mesh, or its sphere; below 0 outside."""
    if solid.ball:
        return solid.half_mm[0] - np.linalg.norm(points - solid.centre_mm, axis=1)
    mesh = trimesh.Trimesh(*solid.mesh)
    heights = np.einsum("nfi,fi->nf", points[:, None] - mesh.triangles[:, 0], mesh.face_normals)
    return -heights.max(axis=1)


def test_the_blocked_share_of_a_lamp_over_a_wide_block_is_its_form_factor():
    """A square face parallel to a small lamp, at a distance of half its side: the closed form of four corners."""
    lamp = np.array([-1.0, 200.0, -1.0])
    block = Solid(np.array([0.0, 50.0, 0.0]), np.array([100.0, 50.0, 100.0]))
    # form factor from a point to a parallel square of half side a at distance h, here a = h (closed form of a corner)
    corner = (1 / (2 * np.pi)) * 2 * (1 / np.sqrt(2)) * np.arctan(1 / np.sqrt(2))
    share = blocked_share(lamp, np.array([2.0, 2.0]), [block])
    assert abs(share - 4 * corner) < 5 * np.sqrt(0.25 / 1024)
    assert blocked_share(lamp, np.array([2.0, 2.0]), []) == 0


def test_a_recipe_that_no_box_fits_says_why(tmp_path):
    cases = {
        "a block is larger than the room": ("width_mm = [80, 160]\ndepth_mm", "width_mm = 900\ndepth_mm"),
        "a block stands in another": ("count = { integer = [1, 2] }", "count = 20"),
    }
    for reason, change in cases.items():
        recipe = load_recipe(write_recipe(tmp_path, change))
        with pytest.raises(InputError, match=rf"all 500 draws of geometry 0 were rejected \(500 times {reason}\)"):
            draw_box(recipe, 0, tmp_path)
    folded = load_recipe(write_recipe(tmp_path, ("k1 = [-0.05, 0.05]", "k1 = -0.3\nfield_deg = 140")))
    with pytest.raises(InputError, match="k1 below 0"):
        draw_box(folded, 0, tmp_path)
    hidden = load_recipe(write_recipe(tmp_path, ("seed = 11", "seed = 11\nmost_blocked = 0.001")))
    with pytest.raises(InputError, match="a lamp is hidden"):
        draw_box(hidden, 0, tmp_path)


def test_the_recipe_of_the_manual_draws_boxes():
    path = ROOT / "docs" / "how-to" / "data-set-recipe.toml"
    recipe = load_recipe(path)
    boxes = [draw_box(recipe, number, path.parent) for number in range(8)]
    assert all(list(box.cameras) == ["main-1-1", "main-1-2"] for box in boxes)
    assert {part_of(recipe, number) for number in range(200)} == {"train", "validation", "test"}


@pytest.mark.parametrize(
    ("change", "phrases"),
    [
        (("seed = 11", "seeed = 11"), "seeed: found an unknown key"),
        (("width_mm = [450, 650]", "width_mm = [650, 450]"), "room.width_mm"),
        (("width_mm = [450, 650]", "width_mm = { normal = [500, 50] }"), "within = [low, high]"),
        (('"cie-224"', '"cie-225"'), "Did you mean 'cie-224'"),
        (('"cornell-box:white"', '"cornell-box:whit"'), "Did you mean 'white'"),
        (('left = "colour"', 'left = "color"'), "Did you mean 'colour'"),
        (("count = { integer = [1, 2] }", "count = [1, 2]"), "block[0].count"),
        (("temperature_k = [2500, 6500]", ""), "lamp[0].temperature_k"),
        (('"D65"', '"D66"'), "lamp[0].spectrum"),
        (('left = "colour"\n', ""), "no left"),
        (("[room]", '[[effect]]\nid = "glos"\n[room]'), "Did you mean 'gloss'"),
        (("[room]", '[[effect]]\nid = "gloss"\nspecular = [0, 2]\n[room]'), "effect[0].specular"),
        (("[room]", '[[effect]]\nid = "gloss"\nmaterial = ["any", "gold"]\nprobability = 0.001\n[room]'), "'gold'"),
        (("[room]", "[parts]\ntrain = 0.5\n[room]"), "shares of sum 0.7"),
        (("[picture]", '[picture]\ntruths = ["albdo"]'), "Did you mean 'albedo'"),
    ],
)
def test_a_faulty_recipe_is_refused_with_file_and_key(tmp_path, change, phrases):
    with pytest.raises(InputError) as raised:
        load_recipe(write_recipe(tmp_path, change))
    assert "recipe.toml" in str(raised.value) and phrases in str(raised.value)


def test_a_picture_that_no_reader_accepts_is_refused(tmp_path):
    large = ("width_px = 16\nheight_px = 16", "width_px = 4096\nheight_px = 4096")
    load_recipe(write_recipe(tmp_path, large))  # 4 wavelengths, four parts of the light: just within the limit
    with pytest.raises(InputError, match=r"camera\[0\]: found a picture with an array of 335544320 values"):
        load_recipe(write_recipe(tmp_path, large, ("step_nm = 100.0", "step_nm = 75.0")))


@pytest.mark.parametrize("way", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_rectangles_are_apart_by_the_gap_between_their_sides(way):
    """One of 30 x 40 mm and one of 50 x 20 mm, side by side 10 mm apart."""
    first, second = _Rectangle(200, 300, 30, 40), np.array([50.0, 20.0])
    corner = np.where(np.array(way) > 0, np.array([30, 40]) + 10, -second - 10) * np.abs(way)
    other = _Rectangle(*(np.array([200.0, 300.0]) + corner), *second)
    assert first.apart(other, 9.9) and not first.apart(other, 10.1)
