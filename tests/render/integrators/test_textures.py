"""Textures: what is seen is the picture itself, and what it reflects is stock Mitsuba's.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.choice import render_image
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import solve_light
from cboxlab.scenes import Material, Spectrum, Texture
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import BANDS, EDGE, FLAT, box_with_lamp, camera_inside, grey
from scipy.ndimage import map_coordinates
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 8
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
RISING = Spectrum(np.array([400.0, 700.0]), np.array([0.05, 0.9]))
FALLING = Spectrum(np.array([400.0, 700.0]), np.array([0.8, 0.1]))


def texture():
    """5 x 4 pixels at random: one paint where the picture is bright, another where it is dark."""
    bright = np.random.default_rng(5).random((5, 4, 1))
    return Texture(np.concatenate([bright, 1 - bright], axis=2), (RISING, FALLING))


def painted(*names, paint=None):
    """The grey box with a texture on some of its walls."""
    box = box_with_lamp(0.6)
    mask = paint or texture()
    surfaces = [replace(s, material="painted", texture_uv=CORNERS) if s.name in names else s for s in box.surfaces]
    materials = {**box.materials, "painted": Material("painted", mask.mean, texture=mask)}
    return replace(box, surfaces=tuple(surfaces), materials=materials)


def on_wall(camera, scene, name):
    """(n, 2) texture coordinates of the places where the rays through all pixels' centres meet a wall's plane."""
    corners = scene.surface(name).vertices_mm
    edges = np.array([corners[1] - corners[0], corners[3] - corners[0]])
    normal = np.cross(*edges)
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    way = camera.directions(u.ravel(), v.ravel())
    distance = (corners[0] - camera.position_mm) @ normal / (way @ normal)
    point = camera.position_mm + distance[:, None] * way
    return (point - corners[0]) @ (edges / EDGE**2).T


@pytest.mark.parametrize("renderer", [render_general_path_tracer, render_stock])
@pytest.mark.parametrize("name", ["back", "left"])
def test_what_the_camera_sees_is_the_picture(renderer, name):
    """Direct light on the wall over that on a white wall: the texture at the pixel, within its slope there."""
    camera = camera_inside(40)
    scene, white = painted(name), painted(name, paint=Texture(np.ones((1, 1, 1)), (FLAT,)))
    arguments = {"samples": 64, "batches": 1, "seed": 1, "max_bounces": 1}
    painted_picture, unpainted = (renderer(RenderJob(s, camera, BANDS, **arguments)) for s in (scene, white))
    where = painted_picture.single_surface & (painted_picture.surface == [s.name for s in scene.surfaces].index(name))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (
            (painted_picture.coefficients @ painted_picture.spectra) / (unpainted.coefficients @ unpainted.spectra)
        )[0]
    u, v = on_wall(camera, scene, name).T
    rows, columns, _ = texture().weights.shape
    values = np.array([v * rows - 0.5, u * columns - 0.5])
    expected = np.zeros((camera.height_px * camera.width_px, 3))
    for k, spectrum in enumerate(texture().spectra):
        weight = map_coordinates(texture().weights[..., k], values, order=1, mode="nearest")
        expected += weight[:, None] * spectrum.at(BANDS)
    expected = expected.reshape(*where.shape, 3)
    assert where.sum() > 150
    error = (ratio - expected)[where]
    assert np.abs(error).mean() < 0.006 and np.abs(error.mean(axis=0)).max() < 0.002
    assert np.ptp(expected[where], axis=0)[[0, 2]].min() > 0.3


def test_what_it_reflects_is_what_stock_mitsuba_says():
    """All walls but the ceiling painted; means over blocks of pixels of each face at three wavelengths."""
    scene, camera = painted("back", "left", "right", "floor", "front"), camera_inside(16)
    ours = render_general_path_tracer(RenderJob(scene, camera, BANDS, 256, BATCHES, seed=1))
    stock = render_stock(RenderJob(scene, camera, BANDS, 512, BATCHES, seed=2), variant="llvm_ad_rgb")
    row, column = np.indices(ours.surface.shape) // 4
    block = np.where(ours.single_surface, 16 * ours.surface + 4 * row + column, -1)
    compared = 0
    for number in np.unique(block[block >= 0]):
        where = block == number
        a, b = ((image.coefficients @ image.spectra)[:, where].mean(axis=1) for image in (ours, stock))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        assert np.all(error < 0.05 * a.mean(axis=0))
        limit = student.isf(0.5e-6, 2 * BATCHES - 2) * error
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < limit)
        compared += 1
    assert compared >= 20


def test_a_picture_of_one_paint_is_that_paint():
    """To rounding, paths being the same; and without a texture in use the final gather takes the scene."""
    even = Texture(np.full((3, 2, 1), 0.5), (RISING,))
    scene, camera = painted("back", "floor", paint=even), camera_inside(8)
    plain = replace(scene, materials={**scene.materials, "painted": Material("painted", RISING.scaled(0.5))})
    assert even.mean.at(BANDS) == pytest.approx(RISING.scaled(0.5).at(BANDS))
    first, other = (render_general_path_tracer(RenderJob(s, camera, BANDS, 16, 1, seed=1)) for s in (scene, plain))
    np.testing.assert_allclose(first.coefficients, other.coefficients, rtol=2e-4, atol=1e-7)
    assert plain.diffuse and not scene.diffuse and scene.lambertian.diffuse
    assert replace(scene, materials={**scene.materials, "painted": grey(0.5, "painted")}).diffuse


def test_a_white_picture_in_a_white_furnace_is_not_seen():
    """A closed box that absorbs nothing: radiance 1 everywhere, whatever mixes to white at every pixel."""
    box = box_with_lamp(1.0, lamp_half=499.0)
    share = np.random.default_rng(1).random((4, 4, 1))
    white = Texture(np.concatenate([share, 1 - share], axis=2), (FLAT, FLAT))
    surfaces = tuple(
        replace(s, material="painted", texture_uv=CORNERS) if s.name != "ceiling" else s for s in box.surfaces
    )
    scene = replace(
        box,
        surfaces=surfaces,
        materials={**box.materials, "painted": Material("painted", FLAT, texture=white)},
    )
    image = render_image(RenderJob(scene, camera_inside(10), BANDS[:1], 512, BATCHES, seed=4))
    values = image.coefficients[:, image.surface >= 0].mean(axis=(1, 2))
    error = values.std(ddof=1) / np.sqrt(BATCHES)
    assert error < 0.003 and abs(values.mean() - 1) < student.isf(0.5e-6, BATCHES - 1) * error


def test_more_of_a_texture_reflects_no_more_than_all():
    """1.5 times as much, but at most 1 at the brightest wavelength of a pixel."""
    scaled = texture().scaled(1.5)
    grid, values = scaled.tables
    before, after = texture().weights @ values, scaled.weights @ values
    most = before.max(axis=2, keepdims=True)
    np.testing.assert_allclose(after, before * np.minimum(1.5, 1 / most), rtol=1e-12)
    assert after.max() == pytest.approx(1.0) and np.array_equal(grid, [400.0, 700.0])


def test_the_final_gather_says_that_it_takes_no_texture():
    with pytest.raises(InputError, match="have a texture"):
        solve_light(painted("back"), BANDS)
