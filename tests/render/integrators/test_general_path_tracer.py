"""Coats, metals, glass, media and patterned lamps, against Mitsuba's own integrators and against themselves.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.choice import render_image
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import solve_light
from cboxlab.scenes import Material, Medium, Spectrum, cornell_box, cornell_camera, load_scene
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import BANDS, EDGE, FLAT, box_with_lamp, camera_inside
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 16
T_LIMIT = float(student.isf(0.5e-6, 2 * BATCHES - 2))
COATED = {"type": "roughplastic", "alpha": 0.2, "int_ior": 1.5, "diffuse_reflectance": "reflectance"}
SLOPE = Spectrum(np.array([400.0, 700.0]), np.array([2e-3, 5e-4]))
PATTERN = np.array([[3.0, 1.0, 0.5], [1.0, 2.0, 0.2]]) / 1.283333333


def with_bsdf(**description):
    """The published box, all that is white of another surface."""
    box = cornell_box()
    white = replace(box.materials["white"], bsdf=description)
    return replace(box, materials={**box.materials, "white": white})


def alone(image):
    """(y, x) pixels that see one surface alone; stock's are known on subpixels only, which miss slivers."""
    return image.single_surface & (image.surface >= 0)


def means(image, used):
    """(batch, w) over the used pixels (y, x), over the lamp's radiance."""
    return (image.coefficients @ image.spectra / image.spectra.max(axis=0))[:, used].mean(axis=1)


def assert_equal(first, other, largest_error):
    used = alone(first) & alone(other)
    a, b = means(first, used), means(other, used)
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
    assert np.all(error < largest_error * a.mean(axis=0)), error / a.mean(axis=0)
    assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < T_LIMIT * error)


SCENES = {
    "coat": (lambda: with_bsdf(**COATED), 0.01),
    "coat that is not affine": (lambda: with_bsdf(**COATED, nonlinear=True), 0.01),
    "metal": (
        lambda: with_bsdf(type="roughconductor", alpha=0.3, material="none", specular_reflectance="reflectance"),
        0.02,
    ),
    "rough glass": (lambda: with_bsdf(type="roughdielectric", alpha=0.4, int_ior=1.3), 0.2),
    "medium": (lambda: replace(cornell_box(), medium=Medium(SLOPE, SLOPE.scaled(0.3), 0.4)), 0.03),
    "patterned lamp": (
        lambda: replace(cornell_box(), lamp=replace(cornell_box().lamp, pattern=PATTERN)),
        0.01,
    ),
}


def assert_as_stock(scene, largest_error, max_bounces=None):
    arguments = {"samples": 128, "batches": BATCHES, "max_bounces": max_bounces}
    ours = render_general_path_tracer(RenderJob(scene, cornell_camera(16), BANDS, seed=1, **arguments))
    stock = render_stock(RenderJob(scene, cornell_camera(16), BANDS, seed=2, **arguments), variant="llvm_ad_rgb")
    assert_equal(ours, stock, largest_error)


@pytest.mark.parametrize("name", SCENES)
def test_stock_mitsuba_shows_the_same(name):
    """The mean over all surfaces agrees with Mitsuba's ``path`` or ``volpath`` within the scatter of batches."""
    build, largest_error = SCENES[name]
    assert_as_stock(build(), largest_error)


def test_the_last_bounce_reflects_all_that_it_should():
    """One bounce off a polished metal: most of the lamp's light is for the samples of directions to find."""
    metal = {"type": "roughconductor", "alpha": 0.08, "material": "none"}
    assert_as_stock(with_bsdf(**metal, specular_reflectance="reflectance"), 0.05, max_bounces=1)


def test_diffuse_scenes_agree_with_the_path_tracer():
    camera = cornell_camera(16)
    scene = replace(cornell_box(), lamp=replace(cornell_box().lamp, pattern=PATTERN))
    pair = [
        r(RenderJob(scene, camera, BANDS, 64, BATCHES, seed=3))
        for r in (render_general_path_tracer, render_path_tracer)
    ]
    assert_equal(*pair, 0.01)


def test_a_white_furnace_with_coat_and_medium_is_white():
    """A closed box that absorbs nothing, lit by a black lamp of radiance 1, has radiance 1 everywhere."""
    scene = box_with_lamp(1.0, lamp_half=499.0)
    coated = replace(scene, materials={"grey": Material("grey", FLAT, {"type": "diffuse", "reflectance": 1.0})})
    hazy = replace(coated, medium=Medium(FLAT.scaled(1 / EDGE), FLAT.scaled(0.0), -0.3))
    camera = camera_inside(12)
    images = [render_general_path_tracer(RenderJob(s, camera, BANDS[:1], 512, BATCHES, seed=4)) for s in (coated, hazy)]
    for image in images:
        values = means(image, alone(image))
        error = values.std(axis=0, ddof=1) / np.sqrt(BATCHES)
        assert np.all(error < 0.003)
        assert np.all(np.abs(values.mean(axis=0) - 1.0) < student.isf(0.5e-6, BATCHES - 1) * error)


def test_other_wavelengths_do_not_change_a_wavelength():
    """Until roulette begins, the picture at 550 nm is the same alone and among seven: paths are shared."""
    scene, camera = with_bsdf(**COATED), cornell_camera(8)
    arguments = {"samples": 8, "batches": 2, "seed": 1, "max_bounces": 2}
    alone = render_general_path_tracer(RenderJob(scene, camera, np.array([550.0]), **arguments))
    among = render_general_path_tracer(RenderJob(scene, camera, np.linspace(400, 700, 7), **arguments))
    assert alone.coefficients[..., 0] == pytest.approx(among.coefficients[..., 3], rel=1e-4, abs=1e-7)


def test_the_door_takes_every_scene_and_the_final_gather_diffuse_ones():
    scene = with_bsdf(**COATED)
    image = render_image(RenderJob(scene, cornell_camera(8), BANDS, samples=4, batches=2))
    assert image.coefficients.shape == (2, 8, 8, 3)
    with pytest.raises(InputError, match=r"found surfaces that are not Lambertian.*; expected a diffuse scene"):
        solve_light(scene, BANDS)


def test_a_surface_that_mitsuba_does_not_know():
    with pytest.raises(InputError, match=r"material.white.bsdf: found a description that Mitsuba rejects"):
        render_general_path_tracer(RenderJob(with_bsdf(type="velvet"), cornell_camera(8), BANDS))


def test_a_scene_file_says_it_all(tmp_path):
    path = tmp_path / "box.toml"
    path.write_text(
        """
format = "scene/1"
name = "coated"
[lamp]
quads_mm = [[[343.0, 548.0, 227.0], [343.0, 548.0, 332.0], [213.0, 548.0, 332.0], [213.0, 548.0, 227.0]]]
radiance = { wavelength_nm = [400, 700], values = [1, 1] }
pattern = [[1, 3], [2, 2]]
[material.white]
reflectance = 0.5
bsdf = { type = "twosided", bsdf = { type = "roughplastic", diffuse_reflectance = "reflectance" } }
[medium]
scattering_per_mm = 1e-4
anisotropy = 0.5
[[surface]]
name = "floor"
material = "white"
quads_mm = [[[552.8, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 559.2], [549.6, 0.0, 559.2]]]
"""
    )
    scene = load_scene(path)
    assert not scene.diffuse
    assert scene.medium.anisotropy == 0.5
    assert scene.medium.absorption_per_mm.at(500.0) == 0
    assert scene.lamp.pattern == pytest.approx(np.array([[0.5, 1.5], [1.0, 1.0]]))
    image = render_image(RenderJob(scene, cornell_camera(8), BANDS, samples=4, batches=2))
    assert image.coefficients.mean() > 0
    path.write_text(path.read_text().replace("pattern = [[1, 3], [2, 2]]", "pattern = [[1, 3], [2]]"))
    with pytest.raises(InputError, match=r"lamp.pattern: found rows of different lengths"):
        load_scene(path)
