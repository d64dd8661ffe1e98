"""Light of lamps whose border is not convex, against Lambert's formula and sums over the lamp."""

import numpy as np
import pytest
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.radiosity.lamp import _sample_pattern, build_lamp_samplers, direct_light
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import Lamp, Scene, Surface
from cboxlab.scenes.shapes import ring_mesh
from helpers.scenes.boxes import EDGE, FLAT, grey, quad, square, walls

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

MIDDLE = np.array([EDGE / 2, EDGE, EDGE / 2])
OUTER, HOLE = square(MIDDLE, 300.0, 1, -1), square(MIDDLE, 150.0, 1, -1)
#: Right above the horizon everywhere, and two that see a part of the lamp only.
NORMALS = np.array([[0, 1, 0], [0.2, 0.9, -0.3], [0.9, 0.1, 0.0], [0, 0.05, -1]], float)


@pytest.fixture(scope="module")
def ring():
    """A lamp with a hole, and a floor."""
    lamp = Lamp(Surface("light", "grey", *ring_mesh(OUTER, HOLE)), FLAT)
    return build_tracer(Scene("ring", (quad("floor", walls()["floor"]),), {"grey": grey(0.5)}, lamp))


def by_lambert(corners, point, normal):
    """Form factor from a point to a polygon above its horizon (Lambert 1760)."""
    way = (corners - point) / np.linalg.norm(corners - point, axis=1)[:, None]
    total = 0.0
    for a, b in zip(way, np.roll(way, -1, axis=0), strict=True):
        axis = np.cross(a, b)
        total += np.arccos(a @ b) * (axis @ normal) / np.linalg.norm(axis)
    return abs(total) / (2 * np.pi)


def by_sum(point, normal):
    """The same of what of the ring is above the horizon, by a grid of 1 mm."""
    x, z = np.meshgrid(np.arange(-299.5, 300), np.arange(-299.5, 300))
    mask = (np.abs(x) > 150) | (np.abs(z) > 150)
    way = np.stack([x[mask], np.zeros(mask.sum()), z[mask]], axis=-1) + MIDDLE - point
    square_mm2 = np.sum(way**2, axis=1)
    return float(np.sum(np.maximum(way @ normal, 0) * way[:, 1] / square_mm2**2) / np.pi)


def light_of(tracer, point, normal, samples):
    """(samples,) by random points of the lamp."""
    u, v = np.random.default_rng(3).random((2, samples)).astype(np.float32)
    position, up = (np.tile(np.array(c, np.float32)[:, None], samples) for c in (point, normal))
    active = mi.Bool(np.ones(samples, bool))
    lamp = build_lamp_samplers(tracer)[0]
    return np.array(
        direct_light(tracer, lamp, mi.Point3f(position), mi.Vector3f(up), mi.Float(u), mi.Float(v), active),
        float,
    )


@pytest.mark.parametrize("normal", NORMALS[:2])
def test_a_ring_above_the_horizon_lights_as_the_square_less_its_hole_without_noise(ring, normal):
    normal = normal / np.linalg.norm(normal)
    for x, z in ((500, 500), (100, 700), (850, 120)):
        point = np.array([x, 0.0, z])
        expected = by_lambert(OUTER, point, normal) - by_lambert(HOLE, point, normal)
        light = light_of(ring, point, normal, 64)
        np.testing.assert_allclose(light, expected, rtol=2e-3)
        assert light.mean() == pytest.approx(by_sum(point, normal), rel=1e-3)


@pytest.mark.parametrize("normal", NORMALS[2:])
def test_a_ring_that_the_horizon_cuts_lights_as_the_sum_over_its_visible_part(ring, normal):
    """Means of 16,384 samples within four of their standard errors."""
    normal, point = normal / np.linalg.norm(normal), np.array([450.0, 0.0, 550.0])
    light = light_of(ring, point, normal, 2**14)
    error = light.std() / np.sqrt(len(light))
    assert 0 < error < 0.02 * light.mean()
    assert light.mean() == pytest.approx(by_sum(point, normal), abs=4 * error)


def test_points_of_a_lamp_lie_as_its_radiance_falls_to_the_edges():
    """Second moments along both sides, by the integral of e + (1 - e) (1 - X^2) (1 - Z^2); the mean is its centre."""
    corners = MIDDLE + np.array([200.0, 0, 50.0]) * (square(MIDDLE, 1.0, 1, -1) - MIDDLE)
    e, numbers = 0.25, (np.arange(280) + 0.5) / 280  # three sevenths of the points are of the even part
    scene = Scene(
        "even", (quad("floor", walls()["floor"]),), {"grey": grey(0.5)}, Lamp(quad("light", corners), FLAT, e)
    )
    u, v = (np.ravel(each).astype(np.float32) for each in np.meshgrid(numbers, numbers))
    sampler = build_lamp_samplers(build_tracer(scene))[0]
    x, _, z = np.array(_sample_pattern(sampler, mi.Float(u), mi.Float(v)), float)
    second = (4 * e / 3 + (1 - e) * 16 / 45) / (4 * e + (1 - e) * 16 / 9)
    for along, half, middle in ((x, 200.0, MIDDLE[0]), (z, 50.0, MIDDLE[2])):
        assert along.mean() == pytest.approx(middle, abs=1e-3 * half)
        assert np.mean((along - middle) ** 2) == pytest.approx(second * half**2, rel=2e-3)
