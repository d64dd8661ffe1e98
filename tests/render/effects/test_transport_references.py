"""Effects of light transport against Mitsuba's own integrators, which share no code with them.

What an effect changes in the mean of a surface, against the same from path tracing. Monte Carlo counts with its own
standard error (4.9 of them: one false alarm in a million comparisons); beyond it the coarse patches may be wrong by a
stated part of the change, which benchmarks/diagnosis/effect_shapes.py measures pixel by pixel.
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked, catalogue
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.perturbation.patch_light import patch_light
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity.final_gather import render_final_gather, solve_light
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from oracles import mitsuba_effects
from scipy.ndimage import binary_dilation

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

NM = np.array([450.0, 550.0, 650.0])
GRID = np.arange(400.0, 701.0)
SIZE, SIGMAS = 24, 4.9
#: What patches of 75 mm may do: part of the change, and of the radiance.
PART, FLOOR = 0.06, 0.004


@pytest.fixture(scope="module")
def published():
    """Box under a lamp of radiance 1, camera, its picture (w, y, x), patches' light, and surfaces as masks."""
    scene, camera = cornell_box(), cornell_camera(SIZE)
    scene = scene.with_lamp(Spectrum(np.array([300.0, 900.0]), np.ones(2)))
    image = render_final_gather(RenderJob(scene, camera, NM, 256, 4, seed=3))
    picture = np.moveaxis(image.project(np.eye(3))[0], -1, 0)
    field = solve_light(scene, NM, patch_edge_mm=75.0, patch_samples=512)
    at_each = (GRID == NM[:, None]).astype(float)
    transport = build_patch_transport(field, camera, 256)
    light = patch_light(transport, scene, NM, GRID, at_each, np.ones(GRID.size))
    used = image.single_surface & ~binary_dilation(image.sees_lamp, np.ones((3, 3)))
    masks = {name: used & (image.surface == i) for i, name in enumerate(image.surface_names)}
    return scene, camera, picture, light, {k: m for k, m in masks.items() if m.sum() > 4}


def assert_as_in_mitsuba(published, identifier, values, floor=FLOOR, part=PART, **options):
    """Means over surfaces: the predicted change against Mitsuba's."""
    scene, camera, picture, light, masks = published
    truth, variance = mitsuba_effects.reference(scene, camera, NM, 256, batches=8, **options)
    before = light.picture()
    after = apply_checked(identifier, values, "test").apply(light).picture()
    predicted = picture * (after / np.where(before > 0, before, 1.0) - 1)
    largest = 0.0
    for name, where in masks.items():
        change, expected = ((x[:, where]).mean(axis=1) for x in (predicted, truth - picture))
        error = np.sqrt(variance[:, where].sum(axis=1)) / where.sum()
        level = picture[:, where].mean(axis=1)
        allowed = part * np.abs(expected) + floor * level + SIGMAS * error
        assert np.all(np.abs(change - expected) <= allowed), (name, change / level, expected / level)
        largest = max(largest, float(np.max(np.abs(change) / level)))
    assert largest > 10 * floor


@pytest.mark.parametrize("identifier", [i for i, e in catalogue().items() if e.stage == "transport"])
def test_an_effect_grows_out_of_nothing(published, identifier):
    """At its null value the picture stays as it is, to rounding, and a hundredth of a strength is near it.

    Changes are linear in the parameter, or of higher order: a hundredth of it makes at most a hundredth of the change,
    and a tenth of that for what saturates.
    """
    effect, light = catalogue()[identifier], published[3]
    before = light.picture()
    fixed = {p.name: p.choices[0] if p.choices else p.default for p in effect.parameters if p.null is None}

    def change(part):
        strengths = {p.name: p.null + part * 0.05 * (p.high - p.null) for p in effect.parameters if p.null is not None}
        applied = apply_checked(identifier, fixed | strengths, "test")
        return float(np.sqrt(np.mean(np.square(applied.apply(light).picture() - before))))

    complete = change(1.0)
    assert change(0.0) <= 1e-6 * complete
    assert change(0.01) <= 1.1e-2 * complete


def test_haze(published):
    """Extinction 0.2 per metre: attenuation on all ways, light scattered into the camera's and onto surfaces."""
    scene, camera, *_ = published
    air = mitsuba_effects.haze(scene, camera, 0.2, 0.7)
    assert_as_in_mitsuba(published, "haze", {"extinction_per_m": 0.2, "albedo": 0.7}, floor=0.012, air=air)


def test_haze_outside_and_in_front_of_the_box_shines_as_in_mitsuba(published):
    """Past the box the camera sees only air that the open front lights; next to the walls there is no light. Six cells
    across, 208 mm each, may be wrong by a tenth of it, Monte Carlo by its own standard error."""
    scene = published[0]
    camera = replace(cornell_camera(SIZE), focal_length_px=0.75 * cornell_camera(SIZE).focal_length_px)
    transport = build_patch_transport(solve_light(scene, NM, patch_edge_mm=75.0, patch_samples=512), camera, 64)
    at_each = (GRID == NM[:, None]).astype(float)
    light = patch_light(transport, scene, NM, GRID, at_each, np.ones(GRID.size))
    air = mitsuba_effects.haze(scene, camera, 0.02, 0.9)
    truth, variance = mitsuba_effects.reference(scene, camera, NM, 512, batches=8, air=air)
    predicted = apply_checked("haze", {"extinction_per_m": 0.02, "albedo": 0.9}, "test").apply(light).picture()
    rows = np.indices(transport.covered.shape)[0]
    for half in (rows < SIZE // 2, rows >= SIZE // 2):
        where = (transport.covered == 0) & half
        assert where.sum() > 50
        predicted_mean, expected = (x[:, where].mean(axis=1) for x in (predicted, truth))
        error = np.sqrt(variance[:, where].sum(axis=1)) / where.sum()
        assert np.all(np.abs(predicted_mean - expected) <= 0.1 * expected + SIGMAS * error), (
            predicted_mean / expected,
            error / expected,
        )


def test_rough_paint(published):
    paint = ("white", mitsuba_effects.oren_nayar(0.5))
    assert_as_in_mitsuba(published, "rough-diffuse", {"material": "white", "sigma_rad": 0.5}, paint=paint)


def test_glossy_paint(published):
    paint = ("green", mitsuba_effects.coat(1.0, 0.3))
    values = {"material": "green", "specular": 1.0, "roughness": 0.3}
    assert_as_in_mitsuba(published, "gloss", values, floor=0.008, paint=paint)


def test_ambient_light(published):
    """A surround of radiance 0.005 of the lamp's at every wavelength: through the front, and past its edges."""
    scene, camera, picture, light, masks = published
    truth, variance = mitsuba_effects.reference(scene, camera, NM, 256, batches=4, surround=0.005)
    level = light.over_lamp(np.full(GRID.size, 0.005))
    lighter = light.change(surround=level)
    change = lighter.picture() - light.picture()
    for where in masks.values():
        error = np.sqrt(variance[:, where].sum(axis=1)) / where.sum()
        expected = (truth - picture)[:, where].mean(axis=1)
        allowed = 0.03 * expected + 0.002 * picture[:, where].mean(axis=1) + SIGMAS * error
        assert np.all(np.abs(change[:, where].mean(axis=1) - expected) <= allowed)
    beyond = light.transport.covered == 0
    assert np.allclose(change[:, beyond], 0.005)
    assert np.allclose(truth[:, beyond], 0.005)


def test_direct_light_of_an_uneven_and_directional_lamp():
    """Irradiance from a lamp summed on a grid in NumPy, where nothing stands between."""
    from dataclasses import replace

    scene = cornell_box()
    for edge, exponent in ((0.3, 0.0), (1.0, 1.5)):
        altered = apply_checked("lamp-nonuniform", {"edge_ratio": edge}, "test").apply(scene)
        altered = apply_checked("lamp-directional", {"exponent": exponent}, "test").apply(altered)
        bare = replace(altered, surfaces=tuple(s for s in altered.surfaces if "block" not in s.name))
        camera = cornell_camera(48)
        field = solve_light(bare, NM, patch_edge_mm=300.0, patch_samples=16, seed=1)
        transport = build_patch_transport(field, camera, 512)
        corners = field.tracer.lamp_triangles().reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        s = (np.arange(80) + 0.5) / 80
        x, z = np.meshgrid(low[0] + s * (high[0] - low[0]), low[2] + s * (high[2] - low[2]))
        points = np.stack([x.ravel(), np.full(x.size, low[1]), z.ravel()], axis=1)
        u = 2 * np.stack(np.meshgrid(s, s), axis=-1).reshape(-1, 2) - 1
        pattern = edge + (1 - edge) * (1 - u[:, 0] ** 2) * (1 - u[:, 1] ** 2)
        pattern /= pattern.mean()
        area = (high[0] - low[0]) * (high[2] - low[2]) / len(points)
        floor = next(i for i, surface in enumerate(bare.surfaces) if surface.name == "floor")
        inside = (transport.surface == floor) & (transport.coverage == 1)
        assert inside.sum() > 200
        for fragment in np.flatnonzero(inside)[::20]:
            way = points - transport.position[fragment]
            square = (way**2).sum(axis=1)
            cosine = way[:, 1] / np.sqrt(square)
            expected = np.sum(pattern * cosine ** (2 + exponent) / square) * area / np.pi
            # a pixel's centre stands for the pixel, whose light is curved a little
            assert transport.direct[fragment, 0] == pytest.approx(expected, rel=0.005)
