"""Angular reflection: the coat's sampling and energy, and what a changed paint adds to a picture.

False alarms: as stated in test_render_physics.
"""

from functools import cache

import numpy as np
import pytest
from cboxlab.rendering.device import device_array, dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation import Coat, Reflection, changed_reflection, fresnel
from cboxlab.rendering.radiosity.final_gather import gather, solve_light
from cboxlab.scenes import cornell_box, cornell_camera
from helpers.scenes.boxes import BANDS, box_with_lamp, camera_inside
from scipy.ndimage import binary_dilation
from scipy.stats import chi2

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

SIGMAS = 4.9
COSINES = [0.05, 0.3, 0.7, 0.999]
ALPHAS = [0.05, 0.25, 0.8]

#: Shares of a single lamp in two bands.
ONE_LAMP = np.ones((1, 2))


def directions(z, phi):
    """Unit vectors from cosines and azimuths, arrays."""
    sine = np.sqrt(1 - z**2)
    return mi.Vector3f(*(device_array(mi.Float, x) for x in (sine * np.cos(phi), sine * np.sin(phi), z)))


def outgoing(cosine, count):
    """Many copies of a direction at that cosine from the normal, turned 0.4 rad about it, as data of a kernel."""
    sine = np.sqrt(1 - cosine**2)
    entries = sine * np.cos(0.4), sine * np.sin(0.4), cosine
    return mi.Vector3f(*(dr.opaque(mi.Float, float(x), count) for x in entries))


def hemisphere(cells, fine, power=3):
    """Midpoints of equal parts of each cell, (cells * fine)^2 in all: cosines, azimuths, solid angles.

    Cosines go as 1 - s^power to resolve a lobe round the normal.
    """
    s = (np.arange(cells * fine) + 0.5) / (cells * fine)
    edge = 1 - (np.arange(cells * fine + 1) / (cells * fine)) ** power
    phi = 2 * np.pi * s
    z = np.repeat(1 - s**power, len(s))
    weight = np.repeat(-np.diff(edge), len(s)) * 2 * np.pi / len(s)
    return z, np.tile(phi, len(s)), weight


def sampled(coat, cosine, log2=17, seed=1):
    """Directions (3, n) of the coat's own sampling."""
    u, v = np.random.default_rng(seed).random((2, 2**log2)).astype(np.float32)
    return np.array(coat.sample(outgoing(cosine, 2**log2), device_array(mi.Float, u), device_array(mi.Float, v)))


def test_fresnel_at_normal_and_grazing_incidence():
    """((n - 1) / (n + 1))^2 = 0.04 straight on, 1 at grazing, 0.0918 for diffuse light (n = 1.5)."""
    assert np.array(fresnel(mi.Float([1.0, 0.0]))) == pytest.approx([0.04, 1.0], abs=1e-6)
    assert np.array(fresnel(mi.Float([-((4 / 13) ** 0.5), -1.0]))) == pytest.approx([1.0, 1.0], abs=1e-6)
    cosine = (np.arange(100_000) + 0.5) / 100_000
    value = np.array(fresnel(mi.Float(cosine.astype(np.float32))), float)
    assert np.mean(2 * cosine * value) == pytest.approx(0.0918, abs=5e-5)


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_samples_follow_the_stated_density(alpha, cosine):
    """Counts in cells of equal parts of the hemisphere and below it (chi-squared, 1e-6).

    With it the density's integral is the part of samples above the horizon, which completes it to 1.
    """
    coat = Coat(1.0, alpha)
    x, y, z = sampled(coat, cosine)
    assert np.sqrt(x * x + y * y + z * z) == pytest.approx(1.0, abs=1e-4)
    cells, fine = 12, 300 if alpha < 0.1 else 100  # a narrow lobe at grazing takes more
    cos, phi, solid = hemisphere(cells, fine)
    density = np.array(coat.density(directions(cos, phi), outgoing(cosine, len(cos))), float)
    expected = (density * solid).reshape(cells, fine, cells, fine).sum(axis=(1, 3)).ravel()
    above = z > 0
    row = np.minimum((np.cbrt(1 - z[above]) * cells).astype(int), cells - 1)
    column = (np.mod(np.arctan2(y[above], x[above]), 2 * np.pi) / (2 * np.pi) * cells).astype(int) % cells
    count = np.bincount(row * cells + column, minlength=cells**2)
    expected = np.append(expected, max(1 - expected.sum(), 0.0)) * len(z)
    count = np.append(count, np.sum(~above))
    # cells that hold few samples are taken together: chi-squared needs some in each
    rare = expected < 50
    expected = np.append(expected[~rare], expected[rare].sum() + 1e-3 * len(z))
    count = np.append(count[~rare], count[rare].sum() + 1e-3 * len(z))
    statistic = np.sum((count - expected) ** 2 / expected)
    assert chi2.sf(statistic, len(count) - 1) > 1e-6


@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_coat_reflects_alike_both_ways(alpha):
    """Helmholtz: exchanging the directions of incoming and outgoing light changes nothing."""
    generator = np.random.default_rng(2)
    incidence, other = (directions(generator.random(4096), 2 * np.pi * generator.random(4096)) for _ in range(2))
    coat = Coat(0.7, alpha)
    assert np.array(coat.value(incidence, other)) == pytest.approx(np.array(coat.value(other, incidence)), rel=1e-3)


@cache
def quadrature():
    """Directions over the hemisphere, and their solid angles times their cosines."""
    cos, phi, solid = hemisphere(1, 1200)
    return directions(cos, phi), cos * solid


def coat_albedo(coat, cosine):
    """Part of light from the direction at ``cosine`` that the coat reflects, by quadrature of the lobe."""
    toward, weight = quadrature()
    return np.sum(np.array(coat.value(toward, outgoing(cosine, len(weight)))) * weight)


def test_the_albedo_by_samples_is_that_by_quadrature():
    coat, cosines = Coat(0.8, 0.25), [0.2, 0.6, 0.95]
    expected = [coat_albedo(coat, cosine) for cosine in cosines]
    assert coat.albedo(np.array(cosines)) == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.25, 0.5, 0.8])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_base_and_coat_reflect_no_more_than_arrives(alpha, scale):
    """A perfectly white base under the coat: the whole albedo is at most 1 at every angle.

    The base gets and gives what Fresnel lets through: (1 - s F(o)) (1 - s 0.0918).
    """
    coat = Coat(scale, alpha)
    for cosine in (0.05, 0.1, 0.2, 0.4, 0.7, 1.0 - 1e-6):
        through = 1 - scale * float(np.array(fresnel(mi.Float([cosine])))[0])
        base = through * (1 - scale * 0.0918)
        reflected = coat_albedo(coat, cosine)
        assert 0 < reflected < scale
        assert base + reflected <= 1.0 + 1e-4


@pytest.fixture(scope="module")
def bright_box():
    """A closed box under a large lamp, all of whose patches shine like the lamp: radiance 1 everywhere."""
    light = solve_light(box_with_lamp(0.5, lamp_half=400.0), BANDS[:2], patch_edge_mm=250.0)
    return light, camera_inside(12), np.ones((len(light.patches), 2))


def everywhere(camera):
    """All pixels of a camera."""
    return np.arange(camera.width_px * camera.height_px)


def lambert(incoming, outgoing):
    return mi.Float(1)


def test_an_unchanged_paint_changes_nothing(bright_box):
    """Lambert's own reflection, without a coat or with one of scale 0: exactly zero."""
    light, camera, radiance = bright_box
    for coat in (None, Coat(0.0, 0.2)):
        change = changed_reflection(
            light,
            camera,
            radiance,
            np.array([[0.5, 0.2]]),
            ONE_LAMP,
            Reflection(lambert, coat),
            material=0,
            seen_in=everywhere(camera),
            samples=(16, 16),
        )
        assert change.shape == (2, 12, 12)
        assert np.all(change == 0)


def test_other_paints_are_left_alone():
    """In the published box a coat on the red paint shows where red walls are, and nowhere else."""
    scene, camera = cornell_box(), cornell_camera(16)
    light = solve_light(scene, BANDS[:2], patch_edge_mm=300.0, patch_samples=64)
    radiance, red = np.ones((len(light.patches), 2)), list(scene.materials).index("red")
    change = changed_reflection(
        light,
        camera,
        radiance,
        np.ones((3, 2)),
        ONE_LAMP,
        Reflection(lambert, Coat(1.0, 0.2)),
        material=red,
        seen_in=everywhere(camera),
        samples=(64, 64),
    )
    image = gather(light, camera, 4, 1)
    covered = image.coverage[..., [scene.surfaces[f].material == "red" for f in image.facet_surface[:-1]] + [False]]
    assert np.all(change[:, covered.sum(axis=-1) == 1] > 0)
    assert np.all(change[:, binary_dilation(covered.any(axis=-1)) == 0] == 0)


def test_half_the_reflection_in_an_evenly_bright_room(bright_box):
    """Reflection halved at all angles under radiance 1 from everywhere: the change is -rho / 2, half a wall."""
    light, camera, radiance = bright_box
    rho = np.array([0.5, 0.2])
    change = changed_reflection(
        light,
        camera,
        radiance,
        rho[None],
        ONE_LAMP,
        Reflection(lambda i, o: mi.Float(0.5)),
        material=0,
        seen_in=everywhere(camera),
        samples=(256, 256),
    )
    walls = gather(light, camera, 4, 1).coverage[..., -1] == 0
    for band, expected in zip(change, -0.5 * rho, strict=True):
        values = band[walls]
        error = values.std(ddof=1) / np.sqrt(len(values))
        assert error < 0.01 * abs(expected)
        assert abs(values.mean() - expected) < SIGMAS * error


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.8])
def test_a_coat_in_an_evenly_bright_room(bright_box, alpha):
    """Radiance 1 from everywhere, lamp included: a coat adds its own albedo, whatever path found the lamp.

    Pixel by pixel, against quadrature at the angle under which the pixel's centre sees its wall.
    """
    light, camera, radiance = bright_box
    coat = Coat(1.0, alpha)
    change = changed_reflection(
        light,
        camera,
        radiance,
        np.zeros((1, 2)),
        ONE_LAMP,
        Reflection(lambert, coat),
        material=0,
        seen_in=everywhere(camera),
        samples=(256, 256),
    )
    assert np.array_equal(change[0], change[1])
    image = gather(light, camera, 4, 1)
    used = image.single_surface & (image.surface >= 0)
    v, u = np.nonzero(used)
    facet = np.argmax(image.coverage[used], axis=1)
    first = [np.argmax(light.tracer.facet == f) for f in facet]
    cosine = -np.sum(camera.directions(u, v) * light.tracer.normals[first], axis=1)
    grid = np.linspace(0.03, 1.0 - 1e-6, 40)
    expected = np.interp(cosine, grid, [coat_albedo(coat, c) for c in grid])
    steep = cosine > 0.25  # nearer to grazing a pixel holds many angles
    assert steep.sum() > 80
    difference = (change[0][used] - expected)[steep]
    assert np.sqrt(np.mean(difference**2)) < 0.1 * expected[steep].mean()
    assert abs(difference.mean()) < 0.01 * expected[steep].mean()


def test_the_reflection_before_has_its_directions_in_an_evenly_bright_room():
    """Radiance 1 from everywhere: what a wall sends to another one is (1.5 rho c + A(c)) at cosine c from its normal,
    where the patches have rho plus the coat's mean albedo. The difference reaches the pixel by Lambert's law."""
    rho, coat = 0.5, Coat(1.0, 0.3)
    light, camera = (
        solve_light(box_with_lamp(rho, lamp_half=5.0), BANDS[:2], patch_edge_mm=250.0),
        camera_inside(12),
    )
    grid = np.linspace(0.005, 1.0, 200)
    table = coat.albedo(grid)
    mean = 2 * float(np.trapezoid(table * grid, grid))
    packed = mi.Float(table.astype(np.float32))

    def albedo(cosine):
        index = mi.UInt32(dr.clip(200 * cosine - 0.5, 0, 199))
        return mi.Float(1), dr.gather(mi.Float, packed, index)

    with_it, without = (
        changed_reflection(
            light,
            camera,
            np.ones((len(light.patches), 2)),
            np.full((1, 2), rho),
            ONE_LAMP,
            Reflection(lambda i, o: 1.5 * o.z, coat, means),
            material=0,
            seen_in=everywhere(camera),
            samples=(1024, 1024),
        )[0]
        for means in (albedo, None)
    )
    image = gather(light, camera, 4, 1)
    used = image.single_surface & (image.surface >= 0)
    v, u = np.nonzero(used)
    triangle = [np.argmax(light.tracer.facet == f) for f in np.argmax(image.coverage[used], axis=1)]
    normal, corner = light.tracer.normals[triangle], light.tracer.vertices[triangle, 0]
    # two points of Gauss and Legendre along each side of a pixel, whose light is a mean
    corners = 0.5 / np.sqrt(3) * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    way = np.concatenate([camera.directions(u + right, v + down) for right, down in corners])
    normal, corner = np.tile(normal, (4, 1)), np.tile(corner, (4, 1))
    depth = np.sum((corner - camera.position_mm) * normal, axis=1) / np.sum(way * normal, axis=1)
    wall_point = camera.position_mm + depth[:, None] * way
    # directions of equal weight in Lambert's law, and the cosine at the wall of the cube that each meets
    z, phi = np.sqrt((np.arange(4096) + 0.5) / 4096), 2 * np.pi * 0.618034 * (np.arange(4096) + 0.3)
    local = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z])
    expected = []
    for point, n in zip(wall_point, normal, strict=True):
        frame = np.linalg.qr(np.column_stack([n, np.eye(3)]))[0]
        direction = np.column_stack([frame[:, 1], frame[:, 2], n]) @ local
        reach = np.where(direction > 0, 1000.0 - point[:, None], -point[:, None]) / direction
        cosine = np.abs(np.take_along_axis(direction, reach.argmin(axis=0)[None], axis=0)[0])
        expected.append(rho * np.mean(rho * (1.5 * cosine - 1) + np.interp(cosine, grid, table) - mean))
    change, expected = (with_it - without)[used], np.reshape(expected, (4, -1)).mean(axis=0)
    assert np.std(expected) > 0.01
    assert np.std(change - expected) < 0.1 * np.std(expected)
    assert abs(np.mean(change - expected)) < 0.02 * np.std(expected)
