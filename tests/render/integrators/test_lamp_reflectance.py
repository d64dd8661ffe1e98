"""A lamp that reflects: an enclosure with an exact answer, all integrators against each other, the published box.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.bounces import render_bounces
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from helpers.scenes.boxes import BANDS, FLAT, box_with_lamp, camera_inside
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 8
OWN = [render_path_tracer, render_final_gather, render_general_path_tracer]
SLOPE = Spectrum(BANDS, np.array([0.3, 0.6, 0.9]))


def looking_up():
    """A camera in the box that sees the lamp and the walls around it."""
    return replace(camera_inside(16), focal_length_px=5.0)


def over_lamp(image, where):
    """(batch, w) means over some pixels."""
    return (image.coefficients[:, where] @ image.spectra).mean(axis=1)


@pytest.mark.parametrize("render", OWN)
def test_white_walls_give_a_lamp_back_what_it_reflects_no_less(render):
    """Walls of perfect white around a lamp of radiance 1 and reflectance r: radiance 1 / (1 - r), the lamp's too.

    In equilibrium the lamp sends out as much as falls on it: L = 1 + r L. Patches of the gather, wider than the ring of
    ceiling around this lamp, may be wrong by 0.1 %.
    """
    bias = 0.002 if render is render_final_gather else 0.0
    scene = box_with_lamp(1.0, lamp_half=450.0, reflectance=FLAT.scaled(0.5))
    image = render(RenderJob(scene, looking_up(), BANDS[:1], samples=256, batches=BATCHES, seed=5))
    for where in (image.coverage[..., -1] == 1, image.coverage[..., -1] == 0):
        assert where.sum() > 10
        values = over_lamp(image, where)[:, 0]
        error = values.std(ddof=1) / np.sqrt(BATCHES)
        assert error < 0.01
        assert abs(values.mean() - 2.0) < student.isf(0.5e-6, BATCHES - 1) * error + bias


@pytest.fixture(scope="module")
def references():
    """A grey box with a large lamp that reflects, by stock Mitsuba: all light, and three reflections at most."""
    scene = box_with_lamp(0.7, lamp_half=300.0, reflectance=SLOPE)
    return {
        n: render_stock(
            RenderJob(scene, looking_up(), BANDS, 256, BATCHES, seed=2, max_bounces=n), variant="llvm_ad_rgb"
        )
        for n in (None, 3)
    }


@pytest.mark.parametrize("max_bounces", [None, 3])
@pytest.mark.parametrize("render", OWN)
def test_stock_mitsuba_shows_the_same_lamp_and_walls(references, render, max_bounces):
    """Means over the lamp's pixels and over the walls' agree; the lamp's reflection is more than ten errors."""
    scene = box_with_lamp(0.7, lamp_half=300.0, reflectance=SLOPE)
    black = replace(scene, lamp=replace(scene.lamp, reflectance=FLAT.scaled(0.0)))
    arguments = {"samples": 128, "batches": BATCHES, "seed": 1, "max_bounces": max_bounces}
    ours, without = (render(RenderJob(s, looking_up(), BANDS, **arguments)) for s in (scene, black))
    other = references[max_bounces]
    for where in (ours.coverage[..., -1] == 1, ours.coverage[..., -1] == 0):
        a, b = over_lamp(ours, where), over_lamp(other, where)
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        assert np.all(error < 2e-3)
        limit = student.isf(0.5e-6, 2 * BATCHES - 2) * error
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < limit)
        more = a.mean(axis=0) - over_lamp(without, where).mean(axis=0)
        assert np.all(np.diff(more) > 0) and more[-1] > 10 * error[-1]


def test_the_parts_by_reflections_add_up():
    """What the lamp reflects is among the light reflected once or more, and the lamp alone shows its emission."""
    scene = box_with_lamp(0.7, lamp_half=300.0, reflectance=SLOPE)
    parts = render_bounces(RenderJob(scene, looking_up(), BANDS, samples=64, batches=2, seed=1), bounces=2)
    image = render_path_tracer(RenderJob(scene, looking_up(), BANDS, samples=64, batches=2, seed=1))
    lamp = image.coverage[..., -1] == 1
    np.testing.assert_allclose(parts.sel(part="0").values[:, lamp], 1.0, rtol=1e-6)
    assert np.all(parts.sel(part="1").values[:, lamp] == 0)
    assert parts.sel(part="2").values[:, lamp].mean() > 0.03
    np.testing.assert_allclose(parts.sum("part").values, image.coefficients @ image.spectra, rtol=1e-4, atol=1e-5)


def test_the_published_box_is_as_much_brighter_as_another_simulation_says():
    """More light with a reflectance of 0.78 than with 0: 0.69 % at 448 nm, 0.77 % at 552 nm, 0.86 % at 652 nm."""
    scene, camera, at = cornell_box().with_lamp(FLAT), cornell_camera(24), np.array([448.0, 552.0, 652.0])
    black = replace(scene, lamp=replace(scene.lamp, reflectance=FLAT.scaled(0.0)))
    means = []
    for box in (scene, black):
        image = render_final_gather(RenderJob(box, camera, at, samples=512, batches=1, seed=4))
        means.append(over_lamp(image, image.coverage[..., -1] == 0)[0])
    assert 100 * (means[0] / means[1] - 1) == pytest.approx([0.69, 0.77, 0.86], abs=0.03)
