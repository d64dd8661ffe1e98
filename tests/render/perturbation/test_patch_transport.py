"""The scene's light exchange as matrices: its picture against the final gather's, and against enclosures.

False alarms: as stated in test_render_physics. Beyond them the patches themselves may be wrong by a stated
part: a patch has one radiance, where the gather knows each point's.
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation.patch_light import patch_light
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity import build_patched_scene
from cboxlab.rendering.radiosity.final_gather import gather, solve_light
from cboxlab.rendering.visibility.primary import facet_coverage
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import cornell_box, cornell_camera
from helpers.scenes.boxes import BANDS, EDGE, FLAT, box_with_lamp, camera_inside, grey, lamp_and, quad, square, walls
from scipy.ndimage import binary_dilation
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

SETS, BATCHES = 6, 6
T_LIMIT = float(student.isf(0.5e-6, min(SETS, BATCHES) - 1))
#: What patches of 40 mm may do to a surface's mean in the published box, and to the whole picture's.
SURFACE_BIAS, PICTURE_BIAS = 0.005, 0.002


def light_of(transport, scene, wavelength_nm, max_bounces=None):
    """The picture's light with one band at each wavelength."""
    lamp = scene.lamp.radiance.at(wavelength_nm)
    return patch_light(transport, scene, wavelength_nm, wavelength_nm, np.eye(len(lamp)), lamp, max_bounces=max_bounces)


def test_a_fragment_lies_where_the_pixels_central_ray_meets_its_face():
    """Pixels that see one face alone: its plane holds the point, and the camera shows it at the pixel's centre."""
    scene, camera = (
        cornell_box(),
        replace(cornell_camera(12), k1=-0.1, position_mm=np.array([290.0, 250.0, -700.0])),
    )
    light = solve_light(scene, BANDS[1:2], patch_edge_mm=400.0, patch_samples=4)
    transport = build_patch_transport(light, camera, 4)
    alone = transport.coverage == 1
    assert alone.sum() > 60
    row, column = np.divmod(transport.pixel[alone], 12)
    off = np.abs(camera.project(transport.position[alone]) - np.stack([column, row], axis=1)).max(axis=1)
    assert np.mean(off < 1e-6) > 0.9 and off.max() < 0.1  # points beyond a face's extent are moved to its border
    for fragment in np.flatnonzero(alone)[off < 1e-6]:
        corners = light.tracer.vertices[light.tracer.facet == transport.face[fragment]].reshape(-1, 3)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        assert abs((transport.position[fragment] - corners[0]) @ normal) < 1e-6
        assert abs(transport.normal[fragment] @ normal) == pytest.approx(1, abs=1e-6)


@pytest.fixture(scope="module")
def published():
    """The box, its camera, and exchanges traced with several seeds over one radiosity solution."""
    scene, camera = cornell_box(), cornell_camera(24)
    light = solve_light(scene, BANDS[1:], seed=1)
    return scene, camera, [build_patch_transport(light, camera, 512, seed=s) for s in range(SETS)]


@pytest.mark.parametrize("max_bounces", [None, 1, 2])
def test_the_picture_is_the_gathers(published, max_bounces):
    """Means over surfaces and over the picture agree within noise and what patches may do.

    Pixels next to the lamp stay out: coverage is known to 1/64 only, and that much lamp outshines a ceiling.
    """
    scene, camera, transports = published
    image = gather(solve_light(scene, BANDS[1:], max_bounces, seed=1), camera, 256, BATCHES, seed=2)
    expected = (image.coefficients @ image.spectra) / scene.lamp.radiance.at(BANDS[1:])
    pictures = np.stack([light_of(t, scene, BANDS[1:], max_bounces).picture() for t in transports])
    pictures = np.moveaxis(pictures, 1, -1)
    used = image.single_surface & (image.surface >= 0) & ~binary_dilation(image.sees_lamp, np.ones((3, 3)))
    parts = [(used & (image.surface == s), SURFACE_BIAS) for s in range(len(image.surface_names))]
    for where, bias in [*parts, (used, PICTURE_BIAS)]:
        a, b = (x[:, where].mean(axis=1) for x in (pictures, expected))
        error = np.sqrt(a.var(axis=0, ddof=1) / SETS + b.var(axis=0, ddof=1) / BATCHES)
        mean = b.mean(axis=0)
        assert np.all(np.abs(a.mean(axis=0) - mean) <= bias * mean + T_LIMIT * error)
    assert np.all(error < 0.001 * mean)


def test_the_lamps_own_reflection_is_the_gathers(published):
    """Where the camera sees the lamp: its emission and what it reflects, to a hundredth of the reflected light."""
    scene, camera, transports = published
    camera = replace(camera, focal_length_px=5.0, position_mm=np.array([278.0, 273.0, 100.0]))
    light = transports[0].light
    image = gather(light, camera, 1024, 2, seed=3)
    lamp = image.coverage[..., -1] == 1
    assert lamp.sum() > 4
    expected = (image.project(np.eye(2))[0] / scene.lamp.radiance.at(BANDS[1:]))[lamp] - 1
    picture = light_of(build_patch_transport(light, camera, 1024), scene, BANDS[1:]).picture()[:, lamp].T - 1
    assert np.all(expected > 0.005)
    assert picture.mean(axis=0) == pytest.approx(expected.mean(axis=0), rel=0.01)
    assert picture == pytest.approx(expected, rel=0.1)


def test_without_reflection_there_is_the_lamp(published):
    """No reflection: the lamp's coverage of pixels, equal in all bands, as exact as 512 rays in a pixel are."""
    scene, camera, transports = published
    picture = light_of(transports[0], scene, BANDS[1:], 0).picture()
    assert picture.shape[0] == 2
    coverage = facet_coverage(build_tracer(scene), camera, samples=4096)[..., -1]
    assert coverage.max() > 0.5
    assert picture == pytest.approx(np.stack([coverage, coverage]), abs=0.01)


def test_the_lamps_own_pixels_follow_its_pattern():
    """A lamp dark at its corners and narrow in its light: the picture of it is the gather's, to 1%."""
    scene = box_with_lamp(0.5, lamp_half=400.0, edge_ratio=0.3, exponent=2.0)
    camera = replace(camera_inside(16), focal_length_px=5.0)
    light = solve_light(scene, BANDS[1:], patch_edge_mm=150.0)
    image = gather(light, camera, 256, 2)
    picture = light_of(build_patch_transport(light, camera), scene, BANDS[1:]).picture()
    lamp = image.coverage[..., -1] == 1
    image_px = image.project(np.eye(2))[0][lamp]
    assert lamp.sum() > 10
    assert np.ptp(image_px) > 0.2
    assert picture[:, lamp].T == pytest.approx(image_px, rel=0.01, abs=0.005)


def test_only_the_lamps_light_is_traced_again_for_another_pattern():
    """The same numbers as from a complete trace, and other light than the first pattern's."""
    even, camera = cornell_box(), cornell_camera(12)
    dim_at_edges = even.with_lamps(lambda lamp: replace(lamp, edge_ratio=0.0, exponent=1.6))
    patched = [build_patched_scene(scene, 200.0, 16, 1) for scene in (even, dim_at_edges)]
    alike, complete = (build_patch_transport(light, camera, 16, 1) for light in patched)
    relit = build_patch_transport(patched[1], camera, 16, 1, alike)
    for name in ("direct", "lamp_radiance", "escape", "covered", "position"):
        assert np.array_equal(getattr(relit, name), getattr(complete, name)), name
    assert (relit.gather != complete.gather).nnz == 0 and relit.light is patched[1]
    assert not np.allclose(relit.direct, alike.direct, rtol=0.1)
    assert not np.allclose(relit.lamp_radiance, alike.lamp_radiance, rtol=0.1)


def outside():
    """A lamp that lights nothing that the tests look at."""
    return square(np.full(3, -5 * EDGE), 10.0, 1, -1)


def test_a_lone_plate_in_a_bright_surround():
    """No light but a uniform surround's 1: a plate shows its reflectance, everything else shows 1."""
    scene = lamp_and([quad("plate", square(np.array([500.0, 500.0, 500.0]), 300.0, 2, -1))], outside())
    camera = camera_inside(16, z=-500.0)
    light = solve_light(scene, BANDS, patch_edge_mm=200.0)
    transport = build_patch_transport(light, camera, 64)
    assert transport.escape == pytest.approx(1.0, abs=1e-6)
    picture = light_of(transport, scene, BANDS).change(surround=np.array([1.0, 2.0, 0.0])).picture()
    covered = transport.covered
    assert 0 < (covered == 1).sum() < covered.size
    for band, surround in zip(picture, (1.0, 2.0, 0.0), strict=True):
        assert band == pytest.approx(surround * (1 - 0.5 * covered), abs=1e-5)


@pytest.mark.parametrize("reflectance", [1.0, 0.5])
def test_an_open_box_in_a_bright_surround(reflectance):
    """A white box cannot be distinguished from the surround that lights it through its front; a grey one is darker.

    In the surround's equilibrium every ray carries the same radiance, whatever it meets.
    """
    boxes = [quad(n, c) for n, c in walls(front=False).items()]
    scene = replace(lamp_and(boxes, outside()), materials={"grey": grey(reflectance)})
    camera = camera_inside(12, z=-900.0, focal=0.9)
    light = solve_light(scene, BANDS[:1], patch_edge_mm=250.0, patch_samples=256)
    transport = build_patch_transport(light, camera, 64)
    picture = light_of(transport, scene, BANDS[:1]).change(surround=np.ones(1)).picture()[0]
    inside = transport.covered == 1
    assert inside.sum() > 50
    if reflectance == 1.0:
        assert picture == pytest.approx(1.0, abs=1e-3)
    else:
        assert np.all(picture[inside] < 0.9)
        assert np.all(picture[inside] > 0.01)


def test_paints_that_emit_add_their_own_light():
    """A closed grey box whose patches emit 1 and reflect r glows with 1 / (1 - r)."""
    scene = lamp_and([quad(n, c) for n, c in walls().items()], outside())
    light = solve_light(scene, BANDS[:1], patch_edge_mm=250.0, patch_samples=128)
    transport = build_patch_transport(light, camera_inside(8), 64)
    plain = light_of(transport, scene, BANDS[:1])
    glowing = plain.change(
        patch_emission=np.ones_like(plain.patch_emission),
        fragment_emission=np.ones_like(plain.fragment_emission),
    )
    assert np.all(plain.picture() == 0)
    assert glowing.picture() == pytest.approx(2.0, rel=1e-4)


def test_bands_are_ratios_of_signals(published):
    """over_lamp weighs a spectrum like the lamp's: the lamp itself has 1 in every band, half of it 1/2."""
    scene, _, transports = published
    grid = np.linspace(400.0, 700.0, 31)
    lamp = scene.lamp.radiance.at(grid)
    weights = np.exp(-0.5 * ((grid - np.array([[500.0], [620.0]])) / 30.0) ** 2)
    light = patch_light(transports[0], scene, np.array([500.0, 620.0]), grid, weights, lamp)
    assert light.over_lamp(lamp) == pytest.approx(1.0)
    assert light.over_lamp(0.5 * lamp) == pytest.approx(0.5)
    assert light.over_lamp(FLAT.at(grid)) == pytest.approx(weights.sum(axis=1) / (weights @ lamp))
