"""Two lamps of different spectra, sizes and planes: all integrators against stock Mitsuba and against each other.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image import RenderJob, light_shares
from cboxlab.rendering.integrators.bounces import render_bounces
from cboxlab.rendering.integrators.derivatives import render_derivatives
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.perturbation.patch_light import patch_light
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity.final_gather import gather, render_final_gather, solve_light
from cboxlab.scenes import Lamp, Material, Medium, Spectrum
from helpers.scenes.boxes import BANDS, EDGE, FLAT, box_with_lamp, camera_inside, quad, square
from scipy.ndimage import binary_dilation
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 8
OWN = [render_path_tracer, render_final_gather, render_general_path_tracer]
WARM = Spectrum(np.array([400.0, 700.0]), np.array([0.5, 3.0]))
COLD = Spectrum(np.array([400.0, 550.0, 700.0]), np.array([6.0, 2.0, 0.0]))
PATTERN = np.array([[0.5, 1.5], [0.5, 1.5]])


def two_lamps(reflectances=(0.0, 0.0), order=1, **further):
    """A large warm lamp in the ceiling and a cold one on the back wall, which light each other."""
    box = box_with_lamp(0.6, lamp_half=250.0)
    corners = square(np.array([300.0, 600.0, EDGE - 1.0]), 120.0, 2, -1)
    cold = Lamp(quad("cold", corners), COLD, reflectance=FLAT.scaled(reflectances[1]), **further)
    warm = replace(box.lamp, radiance=WARM, reflectance=FLAT.scaled(reflectances[0]))
    first, second = (warm, cold)[::order]
    return replace(box, lamp=first, further_lamps=(second,))


def looking_up():
    """A camera in the box that sees both lamps and the walls around them."""
    return replace(camera_inside(20), focal_length_px=6.0)


def radiance(image):
    return image.coefficients @ image.spectra


def assert_agree(first, other, largest_error):
    """Means over the pixels of each face that both see alone, the lamps' among them."""
    faces = 0
    for face in range(first.coverage.shape[-1]):
        where = (first.coverage[..., face] == 1) & (other.coverage[..., face] == 1)
        if where.sum() < 6:
            continue
        a, b = (radiance(image)[:, where].mean(axis=1) for image in (first, other))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        assert np.all(error < largest_error * a.mean(axis=0)), (face, error / a.mean(axis=0))
        limit = student.isf(0.5e-6, 2 * BATCHES - 2) * error + 1e-5 * a.mean(axis=0)  # rounding of stock's film
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < limit), face
        faces += 1
    assert faces >= 5
    assert np.array_equal(first.facet_surface, other.facet_surface)


@pytest.fixture(scope="module")
def references():
    """By stock Mitsuba, which has both lamps in one scene: black and reflecting ones."""
    return {
        reflectances: render_stock(
            RenderJob(two_lamps(reflectances), looking_up(), BANDS, 512, BATCHES, seed=2), variant="llvm_ad_rgb"
        )
        for reflectances in ((0.0, 0.0), (0.5, 0.8))
    }


@pytest.mark.parametrize("reflectances", [(0.0, 0.0), (0.5, 0.8)])
@pytest.mark.parametrize("render", OWN)
def test_stock_mitsuba_shows_the_same(references, render, reflectances):
    ours = render(RenderJob(two_lamps(reflectances), looking_up(), BANDS, samples=128, batches=BATCHES, seed=1))
    assert_agree(ours, references[reflectances], 0.02)
    assert np.array_equal(ours.sees_lamp, (ours.coverage[..., -2:] > 0).any(axis=-1))


def test_coats_and_media_under_two_lamps():
    """The general path tracer samples both lamps at coated surfaces and in the air, and its rays meet both."""
    plain = two_lamps((0.0, 0.4), pattern=PATTERN)
    coat = {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": "reflectance"}
    hazy = Medium(FLAT.scaled(0.4 / EDGE), FLAT.scaled(0.2 / EDGE), 0.3)
    scene = replace(plain, materials={"grey": Material("grey", FLAT.scaled(0.6), coat)}, medium=hazy)
    ours = render_general_path_tracer(RenderJob(scene, looking_up(), BANDS, 128, BATCHES, seed=1))
    stock = render_stock(RenderJob(scene, looking_up(), BANDS, 256, BATCHES, seed=2), variant="llvm_ad_rgb")
    assert_agree(ours, stock, 0.04)


def test_parts_by_reflections_add_up_and_the_lamps_power_is_its_derivative():
    scene, camera = two_lamps((0.5, 0.8)), looking_up()
    arguments = {"samples": 32, "batches": 2, "seed": 1}
    complete = radiance(render_path_tracer(RenderJob(scene, camera, BANDS, **arguments)))
    parts = render_bounces(RenderJob(scene, camera, BANDS, **arguments), bounces=2)
    np.testing.assert_allclose(parts.sum("part").values, complete, rtol=1e-4, atol=1e-5)
    lamps = render_path_tracer(RenderJob(scene, camera, BANDS, **arguments)).coverage[..., -2:]
    for lamp, spectrum in enumerate((WARM, COLD)):
        at_lamp = parts.sel(part="0").values[:, lamps[..., lamp] == 1]
        np.testing.assert_allclose(at_lamp, np.broadcast_to(spectrum.at(BANDS), at_lamp.shape), rtol=1e-5)
    derivatives = render_derivatives(RenderJob(scene, camera, BANDS, **arguments))
    np.testing.assert_allclose(derivatives.lamp * scene.lamp_radiance(BANDS), complete, rtol=1e-4, atol=1e-5)


def test_shares_of_light_are_those_of_the_path_tracer():
    """Once reflected light over all reflected light, as the gather's accumulators and traced paths say."""
    scene, camera = two_lamps((0.5, 0.8)), camera_inside(12)
    image = render_final_gather(RenderJob(scene, camera, BANDS, 256, 2, seed=1))
    shares = light_shares(image, scene, np.eye(3))
    parts = render_bounces(RenderJob(scene, camera, BANDS, samples=256, batches=2, seed=2), bounces=2).mean("batch")
    total = (parts.sum("part") - parts.sel(part="0")).values
    for ours, part in ((shares.direct, "1"), (shares.via_material.sum(axis=0), "2")):
        finite = np.isfinite(ours).all(axis=0)
        expected = (parts.sel(part=part).values / total)[finite].mean(axis=0)
        assert np.moveaxis(ours, 0, -1)[finite].mean(axis=0) == pytest.approx(expected, rel=5e-3)


def of_patches(scene, camera):
    field = solve_light(scene, BANDS, patch_edge_mm=80.0, patch_samples=512, seed=3)
    transport = build_patch_transport(field, camera, 256, seed=3)
    return patch_light(transport, scene, BANDS, BANDS, np.eye(3), scene.lamp_radiance(BANDS))


@pytest.mark.parametrize("max_bounces", [None, 0])
def test_patches_show_the_gathers_picture(max_bounces):
    """Surface means agree within 1 %, what patches may do; each lamp's pixels within what edges of coverage may."""
    scene, camera = two_lamps((0.5, 0.8)), looking_up()
    image = gather(solve_light(scene, BANDS, max_bounces, seed=1), camera, 256, 4, seed=2)
    light = of_patches(scene, camera).change(max_bounces=max_bounces)
    picture = np.moveaxis(light.picture(), 0, -1) * scene.lamp_radiance(BANDS)
    expected = radiance(image).mean(axis=0)
    for face in range(image.coverage.shape[-1]):
        where = image.coverage[..., face] == 1
        if face < image.coverage.shape[-1] - 2:
            where &= ~binary_dilation(image.sees_lamp, np.ones((3, 3)))
        if where.sum() > 6:
            mean = expected[where].mean(axis=0)
            assert picture[where].mean(axis=0) == pytest.approx(mean, rel=0.01, abs=1e-6)


EFFECTS = {
    "haze": {"extinction_per_m": 0.5, "albedo": 0.8},
    "gloss": {"material": "grey", "specular": 0.8, "roughness": 0.2},
    "rough-diffuse": {"material": "grey", "sigma_rad": 0.5},
    "fluorescence": {"material": "grey", "yield": 0.5, "peak_nm": 540.0},
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_what_an_effect_adds_is_the_sum_over_the_lamps_in_any_order(effect):
    """Light is linear in the lamps, under every effect of its transport: the same rays, so to rounding.

    How a dark lamp would shine does not matter.
    """
    nm = np.arange(400.0, 701.0, 5.0)
    indices = np.isin(nm, BANDS).nonzero()[0]
    weights = np.eye(nm.size)[indices]
    dark = Spectrum(np.array([400.0, 700.0]), np.zeros(2))
    camera = replace(camera_inside(8), focal_length_px=3.0)

    def picture_of(scene):
        field = solve_light(scene, BANDS, patch_edge_mm=200.0, patch_samples=256, seed=3)
        transport = build_patch_transport(field, camera, 64, seed=3)
        lamp = scene.lamp_radiance(nm)
        light = patch_light(transport, scene, BANDS, nm, weights, np.maximum(lamp, 1e-9), samples=64)
        changed = apply_checked(effect, EFFECTS[effect], "test").apply(light)
        unit = np.maximum(lamp, 1e-9)[indices][:, None, None]
        return unit * (changed.picture() - light.picture()), unit * light.picture().max()

    both = two_lamps()
    warm = replace(both, further_lamps=(replace(both.further_lamps[0], radiance=dark),))
    cold = both.with_lamp(dark)
    (added, level), (turned, _) = picture_of(both), picture_of(two_lamps(order=-1))
    alone = [picture_of(scene)[0] for scene in (warm, cold)]
    scale = np.abs(added).max(axis=(1, 2), keepdims=True)
    rounding = 1e-4 * scale + 1e-6 * level
    assert np.all(np.abs(added - sum(alone)) < rounding)
    assert np.all(np.abs(added - turned) < rounding)
    aimed = replace(warm, further_lamps=(replace(warm.further_lamps[0], exponent=20.0),))
    assert np.all(np.abs(picture_of(aimed)[0] - alone[0]) < rounding)
    assert all(np.abs(part[1]).max() > 1e-2 * scale[1] for part in alone)
