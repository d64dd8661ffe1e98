"""Media inside closed surfaces, with and without refraction: stock Mitsuba's pictures, Beer's law, a furnace.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import shadow_rays
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.scenes import Material, Medium, Spectrum, Surface
from cboxlab.scenes.shapes import box_mesh
from helpers.scenes.boxes import BANDS, FLAT, box_with_lamp, camera_inside
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 16
NULL = {"type": "null"}
GLASS = {"type": "dielectric", "int_ior": 1.33}
SLOPE = Spectrum(np.array([400.0, 700.0]), np.array([8e-3, 2e-3]))
MILK = Medium(SLOPE, SLOPE.scaled(0.1), 0.6)
HAZE = Medium(FLAT.scaled(4e-4), FLAT.scaled(1e-4), -0.2)
INK = Medium(FLAT.scaled(0.0), SLOPE, 0.0)


def with_block(inside, bsdf, rho=0.7, lamp_half=350.0, **scene):
    """A box with a large lamp and a filled block that hangs before the camera, clear of the walls."""
    box = box_with_lamp(rho, lamp_half=lamp_half)
    block = Surface("block", "skin", *box_mesh([520.0, 450.0, 600.0], [320.0, 380.0, 260.0], 25.0), inside=inside)
    materials = {**box.materials, "skin": Material("skin", FLAT.scaled(0.5), bsdf)}
    return replace(box, surfaces=(*box.surfaces, block), materials=materials, **scene)


def assert_agree(first, other, largest_error):
    """Means over the pixels that see the block alone, and over those that see none of it nor the lamp."""
    block = [first.coverage[..., first.facet_surface == len(first.surface_names) - 1].sum(axis=-1)]
    block += [other.coverage[..., other.facet_surface == len(other.surface_names) - 1].sum(axis=-1)]
    lamp = first.sees_lamp | other.sees_lamp
    for where in ((np.min(block, axis=0) > 0.999) & ~lamp, (np.max(block, axis=0) == 0) & ~lamp):
        assert where.sum() > 12
        a, b = ((image.coefficients @ image.spectra)[:, where].mean(axis=1) for image in (first, other))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        assert np.all(error < largest_error * a.mean(axis=0)), error / a.mean(axis=0)
        limit = student.isf(0.5e-6, 2 * BATCHES - 2) * error
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < limit), (
            a.mean(axis=0),
            b.mean(axis=0),
            error,
        )


SCENES = {
    "milk, index-matched": lambda: with_block(MILK, NULL),
    "milk behind a refracting boundary": lambda: with_block(MILK, GLASS),
    "ink in rough glass": lambda: with_block(INK, {"type": "roughdielectric", "alpha": 0.3, "int_ior": 1.33}),
    "milk in hazy air": lambda: with_block(MILK, NULL, medium=HAZE),
}


@pytest.mark.parametrize("max_bounces", [None, 3])
@pytest.mark.parametrize("name", SCENES)
def test_stock_mitsuba_shows_the_same(name, max_bounces):
    """By ``volpath``: the block itself, and the walls that it lights and shades; a boundary is no bounce."""
    scene, camera = SCENES[name](), camera_inside(16)
    arguments = {"samples": 128, "batches": BATCHES, "max_bounces": max_bounces}
    ours = render_general_path_tracer(RenderJob(scene, camera, BANDS, seed=1, **arguments))
    stock = render_stock(RenderJob(scene, camera, BANDS, seed=2, **arguments), variant="llvm_ad_rgb")
    assert_agree(ours, stock, 0.05)


def under_the_lamp(bsdf, floor=None):
    """A black box whose ceiling shines, and a block of ink 200 mm thick under it; the floor, of metal where asked."""
    box = box_with_lamp(0.0, lamp_half=450.0)
    block = Surface("block", "skin", *box_mesh([500.0, 700.0, 500.0], [400.0, 200.0, 400.0], 0.0), inside=INK)
    materials = {"skin": Material("skin", FLAT.scaled(0.5), bsdf), "metal": Material("metal", FLAT, floor or NULL)}
    surfaces = [replace(s, material="metal") if floor and s.name == "floor" else s for s in box.surfaces]
    return replace(box, surfaces=(*surfaces, block), materials={**box.materials, **materials})


def looking_up():
    upwards = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    return replace(
        camera_inside(8), focal_length_px=24.0, rotation=upwards, position_mm=np.array([500.0, 100.0, 500.0])
    )


def test_what_shines_through_ink_follows_beers_law():
    """A lamp behind an absorbing block, seen straight through it: exp(-absorption times the path in it)."""
    camera = looking_up()
    image = render_general_path_tracer(RenderJob(under_the_lamp(NULL), camera, BANDS, samples=64, batches=1, seed=1))
    v, u = np.mgrid[0:8, 0:8].astype(float)
    cosine = camera.directions(u, v)[..., 1]
    expected = np.exp(-200.0 / cosine[..., None] * INK.absorption_per_mm.at(BANDS))
    np.testing.assert_allclose(image.coefficients[0], expected, rtol=2e-3)


def test_a_shadow_ray_ends_at_the_most_boundaries(monkeypatch):
    """With room for none, a block of thin ink casts a full shadow; with room for its two sides as with any number."""
    thin = replace(INK, absorption_per_mm=SLOPE.scaled(0.05))
    scene, means = with_block(thin, NULL, rho=0.1), []
    for most in (0, 2, 256):
        monkeypatch.setattr(shadow_rays, "_MOST_BOUNDARIES", most)
        image = render_general_path_tracer(RenderJob(scene, camera_inside(16), BANDS, samples=64, batches=1, seed=1))
        means.append(float((image.coefficients @ image.spectra)[:, ~image.sees_lamp].mean()))
    assert means[0] < 0.97 * means[2]
    assert means[1] == pytest.approx(means[2], rel=1e-6)


def test_a_lamp_through_rough_glass_and_its_glint_past_a_boundary_are_stocks():
    """Seen through ink in rough glass; and in a metal floor, past ink without refraction close to the lamp."""
    rough = {"type": "roughdielectric", "alpha": 0.5, "int_ior": 1.6}
    metal = {"type": "roughconductor", "alpha": 0.3, "material": "none"}
    for scene, camera in (
        (under_the_lamp(rough), looking_up()),
        (under_the_lamp(NULL, metal), replace(camera_inside(10), position_mm=np.array([500.0, 300.0, 50.0]))),
    ):
        arguments = {"samples": 256, "batches": BATCHES}
        ours = render_general_path_tracer(RenderJob(scene, camera, BANDS, seed=1, **arguments))
        stock = render_stock(RenderJob(scene, camera, BANDS, seed=2, **arguments), variant="llvm_ad_rgb")
        a, b = (image.coefficients[:, ~ours.sees_lamp & ~stock.sees_lamp].mean(axis=1) for image in (ours, stock))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        assert np.all(error < 0.01 * a.mean(axis=0))
        limit = student.isf(0.5e-6, 2 * BATCHES - 2) * error
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < limit)


@pytest.mark.parametrize("bsdf", [NULL, GLASS])
def test_milk_that_absorbs_nothing_is_not_seen_in_a_white_furnace(bsdf):
    """A closed box that absorbs nothing has radiance 1 everywhere, in the block's pixels, too."""
    white = Medium(FLAT.scaled(5e-3), FLAT.scaled(0.0), 0.5)
    scene = with_block(white, bsdf, rho=1.0, lamp_half=499.0)
    image = render_general_path_tracer(RenderJob(scene, camera_inside(14), BANDS[:1], 512, BATCHES, seed=4))
    block = image.coverage[..., image.facet_surface == len(image.surface_names) - 1].sum(axis=-1) > 0.999
    assert block.sum() > 8
    for where in (block, ~block & ~image.sees_lamp):
        values = image.coefficients[:, where].mean(axis=(1, 2))
        error = values.std(ddof=1) / np.sqrt(BATCHES)
        assert error < 0.006
        assert abs(values.mean() - 1.0) < student.isf(0.5e-6, BATCHES - 1) * error


def test_a_boundary_with_nothing_in_it_is_not_seen():
    """The picture with an empty index-matched block is the one without the block."""
    nothing = Medium(FLAT.scaled(0.0), FLAT.scaled(0.0))
    scene, camera = with_block(nothing, NULL), camera_inside(12)
    without = replace(scene, surfaces=scene.surfaces[:-1])
    first, other = (
        render_general_path_tracer(RenderJob(s, camera, BANDS, 256, BATCHES, seed=n))
        for n, s in enumerate((scene, without))
    )
    used = other.surface >= 0
    a, b = ((image.coefficients @ image.spectra)[:, used].mean(axis=1) for image in (first, other))
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
    assert np.all(error < 0.01 * b.mean(axis=0))
    assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < student.isf(0.5e-6, 2 * BATCHES - 2) * error)
