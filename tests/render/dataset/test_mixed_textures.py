"""Textures: shares of two paints in their places, exact albedo, and the light that an unbiased path tracer finds."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.dataset import draw_box, light_parts, load_recipe, mixed_pixels, mixed_scenes, visible_points
from cboxlab.rendering.dataset.textures import noise_shares, textured
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image, render_passes
from cboxlab.rendering.model import load_model, write_model
from cboxlab.rendering.radiosity.mixtures import patch_shares
from cboxlab.rendering.radiosity.patches import build_patches
from cboxlab.rendering.visibility import build_tracer
from cboxlab.scenes import Spectrum, cornell_box
from cboxlab.scenes.shapes import front_uv
from cboxlab.utils.errors import InputError
from helpers.scenes.recipes import write_recipe
from PIL import Image
from scipy.ndimage import map_coordinates

GRID = np.array([450.0, 650.0])

#: A floor and a ball of noise, and a back wall and a block of an image.
TEXTURES = (
    '[walls]\nfloor = "light"\nceiling = "light"\nback = "light"',
    """[texture.marble]
paints = ["light", "colour"]
features = 4
[texture.picture]
kind = "image"
paints = ["colour", "light"]
image = "grey.png"
[walls]
floor = "marble"
ceiling = "light"
back = "picture\"""",
)

BODIES = (
    'height_mm = [80, 300]\npaint = "light"',
    'height_mm = [80, 300]\npaint = "picture"\n[[block]]\nshape = "sphere"\nradius_mm = 90\npaint = "marble"',
)

GREY = np.random.default_rng(4).integers(0, 256, (4, 5)).astype(np.uint8)


def recipe_of(folder, *changes):
    Image.fromarray(GREY).save(folder / "grey.png")
    return write_recipe(folder, BODIES, TEXTURES, *changes)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    folder = tmp_path_factory.mktemp("textures")
    recipe = load_recipe(recipe_of(folder))
    assert recipe.files == ["grey.png"]
    return draw_box(recipe, 0, folder)


def test_all_shares_of_a_noise_are_as_frequent_and_features_are_counted():
    """Rice (1944): a Gaussian noise of standard deviation s in its filter crosses its mean once in 2^0.5 pi s."""
    for features in (4.0, 8.0):
        each = [noise_shares(features, 1.0, np.random.default_rng(n)) for n in range(40)]
        np.testing.assert_allclose(np.quantile(each, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.02)
        crossings = np.mean([np.mean(np.diff(s > 0.5, axis=1).sum(axis=1)) for s in each])
        assert crossings == pytest.approx(features / (np.sqrt(2) * np.pi * 0.2), rel=0.1)
    low = noise_shares(5.0, 0.3, np.random.default_rng(1))
    assert 0.35 <= low.min() < 0.37 and 0.63 < low.max() <= 0.65


def test_the_map_of_a_sphere_is_equal_in_area():
    """Uniform directions fill a circle of radius 1/2 evenly: the mean square of the distance is 1/8."""
    directions = np.random.default_rng(3).standard_normal((20000, 3))
    uv = front_uv(directions) - 0.5
    distance = np.sum(uv**2, axis=1)
    assert distance.max() <= 0.25 and distance.mean() == pytest.approx(0.125, abs=0.002)
    np.testing.assert_allclose(front_uv([[0, 0, -2.0], [-1.0, 0, 0], [0, 3.0, 0]]), [[0.5, 0.5], [1, 0.5], [0.5, 0]])


def test_paints_of_a_texture_are_those_of_the_box_where_they_are_in_every_scene():
    flat, other = (Spectrum(np.array([400.0, 700.0]), np.array(values)) for values in ([0.2, 0.4], [0.5, 0.1]))
    plain = cornell_box()
    white = plain.materials["white"].reflectance
    scenes = []
    for second in (flat, white):
        shares = np.array([[0.0, 1.0]])
        surfaces = [replace(s, material="mix", texture_uv=s.vertices_mm[:, :2]) for s in plain.surfaces[:1]]
        materials = {
            **plain.materials,
            "mix": textured("mix", shares, (white, second)),
            "alone": replace(plain.materials["red"], name="alone", reflectance=other),
        }
        scenes.append(replace(plain, surfaces=(*surfaces, *plain.surfaces[1:]), materials=materials))
    for scene, second in zip(mixed_scenes(scenes), (flat, white), strict=True):
        assert scene.surfaces[0].parts == ("white", "mix-2") and scene.diffuse
        assert scene.materials["mix-2"].reflectance.values.tolist() == second.values.tolist()
    assert mixed_scenes(scenes[1:])[0].surfaces[0].parts == ("white", "white")
    assert mixed_scenes([plain])[0] is plain


def test_shares_of_patches_conserve_the_mean_of_a_texture(box):
    """The image fills the back wall: its bilinear mean over the wall is that of the patches by area."""
    [scene] = mixed_scenes([box.model.scene])
    tracer = build_tracer(scene)
    patches = build_patches(tracer, 60.0)
    shares = patch_shares(tracer, patches, len(tracer.material_names))
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    assert shares.min() >= 0
    back = patches.surface == [s.name for s in scene.surfaces].index("back")
    light = np.average(shares[back, tracer.material_names.index("light")], weights=patches.area[back])
    fine = np.mgrid[0:4:400j, 0:5:500j] - 0.5
    assert light == pytest.approx(map_coordinates(GREY / 255, fine, order=1, mode="nearest").mean(), rel=2e-3)


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")
@pytest.mark.usefixtures("large_patches")
def test_the_albedo_of_a_texture_is_exact_and_its_light_unbiased(box):
    """Albedo by the image at 256 places in each pixel; light within four standard errors of the path tracer's."""
    camera, original = box.cameras["main"], box.model.scene
    [scene] = mixed_scenes([original])
    assert list(scene.materials) == ["light", "colour"] and not original.diffuse
    image = render_passes(RenderJob(scene, camera, GRID, 64, 8, seed=3))
    points, mean = visible_points(original, camera), image.mean(np.eye(2))
    parts = light_parts(image, scene, mixed_pixels(scene, camera))
    names = [surface.name for surface in scene.surfaces]
    alone = image.coverage.max(axis=-1) == 1
    back = alone & (points.surface == names.index("back"))
    np.testing.assert_allclose(parts.albedo[back], _back_albedo(box, camera)[back], atol=2e-5)
    assert back.sum() > 15 and np.ptp(parts.albedo[back], axis=0).max() > 0.1
    product = parts.albedo * parts.irradiance / np.pi
    faces = [names[n] in ("floor", "back", "1-block", "2-ball") for n in image.facet_surface if n < len(names)]
    painted = (image.coverage[..., : len(faces)][..., faces] > 0).any(axis=-1)  # edges, too
    reflected = mean - parts.reflections[0]
    np.testing.assert_allclose(product[painted], reflected[painted], atol=1e-6 * mean.max())
    traced = render_image(RenderJob(original, camera, GRID, 64, 16, seed=8))
    for surface in range(len(names)):
        on = alone & (image.surface == surface)
        if on.sum() < 5:
            continue
        batches = [[(c[on].mean(axis=0) @ i.spectra) for c in i.coefficients] for i in (image, traced)]
        errors = [np.std(each, axis=0, ddof=1) / np.sqrt(len(each)) for each in batches]
        difference = np.mean(batches[0], axis=0) - np.mean(batches[1], axis=0)
        assert (np.abs(difference) < 4 * np.hypot(*errors) + 2e-3 * np.mean(batches[1], axis=0)).all(), names[surface]


def _back_albedo(box, camera):
    """(y, x, w) mean of the image over each pixel's part of the back wall's plane."""
    width, height, depth = box.record["room_mm"]
    step = (np.arange(16) + 0.5) / 16 - 0.5
    total = np.zeros((camera.height_px, camera.width_px))
    rows, columns = np.indices(total.shape)
    for down in step:
        for right in step:
            d = camera.directions(columns + right, rows + down)
            at = camera.position_mm + (depth - camera.position_mm[2]) / d[..., 2:] * d
            at_pixel = [(1 - at[..., 1] / height) * 4 - 0.5, (1 - at[..., 0] / width) * 5 - 0.5]
            total += map_coordinates(GREY / 255, at_pixel, order=1, mode="nearest") / 256
    first, second = (s.at(GRID) for s in box.model.scene.materials["picture"].texture.spectra)
    return total[..., None] * second + (1 - total[..., None]) * first


def test_a_box_of_textures_is_written_and_read_again(box, tmp_path):
    write_model(tmp_path / "model.toml", box.model)
    read = load_model(tmp_path / "model.toml").scene
    for mine, other in zip(read.surfaces, box.model.scene.surfaces, strict=True):
        assert (mine.name, mine.material, mine.ball) == (other.name, other.material, other.ball)
        if other.texture_uv is not None:
            np.testing.assert_allclose(mine.texture_uv, other.texture_uv, atol=1e-9)
    for name in ("marble", "picture"):
        np.testing.assert_array_equal(
            read.materials[name].texture.weights, box.model.scene.materials[name].texture.weights
        )


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (('"grey.png"', '"none.png"'), "texture.picture.image"),
        (('paints = ["colour", "light"]', 'paints = ["colour", "marble"]'), "texture.picture.paints: found 'marble'"),
        (('image = "grey.png"\n', ""), "without an image"),
        (("features = 4", "features = 40"), "texture.marble.features"),
        (("[texture.marble]", "[texture.light]"), "the name of a paint"),
        (("[[camera]]", '[[effect]]\nid = "haze"\n[[camera]]'), "'haze', an effect on light transport, in a recipe"),
    ],
)
def test_a_faulty_texture_is_refused_with_its_key(tmp_path, change, phrase):
    with pytest.raises(InputError) as raised:
        load_recipe(recipe_of(tmp_path, change))
    assert phrase in str(raised.value)
