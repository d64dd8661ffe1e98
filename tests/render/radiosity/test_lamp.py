"""Light of lamps whose border is not convex, against Lambert's formula and sums over the lamp."""

import numpy as np
import pytest
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.radiosity.lamp import build_lamp_samplers, direct_light
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
