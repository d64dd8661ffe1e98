"""What sampling rests on, against double precision: directions, angles, camera rays; and very many paths."""

import numpy as np
import pytest
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.device.sampling import cosine_hemisphere
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.integrators.path_points import PathPoints
from cboxlab.rendering.radiosity.lamp import angle_over_sine
from cboxlab.rendering.visibility.tracer import pixel_rays
from cboxlab.scenes import Camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")


def _numbers(seed, *shape):
    return np.random.default_rng(seed).random(shape).astype(np.float32)


def test_directions_follow_the_concentric_map():
    """Against Mitsuba's map, and at the square's middle and corners, where angles have no or two values."""
    u, v = np.hstack([_numbers(1, 2, 10_000), [[0.5, 0, 1, 0, 1], [0.5, 0, 1, 1, 0]]]).astype(np.float32)
    ours = np.array(cosine_hemisphere(mi.Vector3f(0.0, 0.0, 1.0), mi.Float(u), mi.Float(v)))
    theirs = np.array(mi.warp.square_to_cosine_hemisphere(mi.Point2f(mi.Float(u), mi.Float(v))))
    assert np.abs(ours - theirs)[:2].max() < 3e-7
    assert np.abs(ours[2] ** 2 - theirs[2] ** 2).max() < 1e-6  # its root is as uncertain as small heights are
    assert np.abs(np.linalg.norm(ours, axis=0) - 1).max() < 3e-7


def test_angles_over_sines_at_all_angles_and_sizes():
    """0.4 millionths over 9 decades of size, from 0 to 180 degrees; with sine 0, its limit."""
    angle = np.concatenate([np.geomspace(1e-6, np.pi / 2, 5000), np.pi - np.geomspace(1e-6, np.pi / 2, 5000)])
    size = 10.0 ** np.random.default_rng(2).uniform(-1, 8, angle.size)
    sine, cosine = ((size * part).astype(np.float32) for part in (np.sin(angle), np.cos(angle)))
    values = np.array(angle_over_sine(mi.Float(sine), mi.Float(cosine)))
    exact = np.arctan2(sine.astype(float), cosine.astype(float)) / sine
    assert np.abs(values / exact - 1).max() < 4e-7
    assert np.array(angle_over_sine(mi.Float([0.0]), mi.Float([5.0]))) == pytest.approx(0.2)


@pytest.mark.parametrize("size", [8, 256])
@pytest.mark.parametrize("k1", [0.0, -0.12, 0.25, 0.6])
def test_rays_of_pixels_are_the_cameras(size, k1):
    """In the corner pixels, too, where distortion moves points by 7 to 17%: within single precision."""
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    camera = Camera(
        width_px=size,
        height_px=size - 2,
        focal_length_px=1.1 * size,
        k1=k1,
        principal_point_px=np.array([0.45, 0.52]) * size,
        rotation=turned * np.sign(np.linalg.det(turned)),
        position_mm=np.array([278.0, 273.0, -800.0]),
    )
    pixel = np.arange(size * (size - 2), dtype=np.uint32)
    u, v = _numbers(4, 2, pixel.size)
    ray = pixel_rays(camera, mi.UInt32(pixel))(mi.Float(u), mi.Float(v))
    exact = camera.directions(pixel % size - 0.5 + u, pixel // size - 0.5 + v)
    assert np.abs(np.array(ray.d).T - exact).max() < 5e-7
    assert np.array(ray.o)[:, 0] == pytest.approx(camera.position_mm)


def test_rays_of_pixels_know_of_further_distortion():
    """A stretch by 1 % to the right: even within each pixel, so that a hundredth of half a pixel is all they miss."""
    size = 64
    camera = Camera(size, size, 1.1 * size, np.full(2, 31.5), -0.05, np.eye(3), np.zeros(3))
    stretched = camera.distorted_further(lambda image_px: 0.01 * (image_px - 31.5) * [1.0, 0.0])
    pixel = np.arange(size * size, dtype=np.uint32)
    u, v = _numbers(4, 2, pixel.size)
    ray = pixel_rays(stretched, mi.UInt32(pixel))(mi.Float(u), mi.Float(v))
    exact = stretched.directions(pixel % size - 0.5 + u, pixel // size - 0.5 + v)
    assert np.abs(np.array(ray.d).T - exact).max() < 0.006 / (1.1 * size)
    assert np.abs(camera.directions(0.0, 32.0) - stretched.directions(0.0, 32.0)).max() > 0.2 / (1.1 * size)


def test_more_paths_than_points_take_other_scramblings():
    """A lane's first 65536 paths and its next are each stratified, and are not the same."""
    count = 2**16
    points = PathPoints(2 * count, mi.UInt32([5]), seed=1)
    index = dr.arange(mi.UInt32, 2 * count)
    for depth in (0, 4):
        u, _ = points.direction(index, dr.opaque(mi.UInt32, depth))
        first, second = np.array(u).reshape(2, count)
        for numbers in (first, second):
            cells = np.bincount((numbers * 4096).astype(int), minlength=4096)
            assert np.all(cells == count // 4096)
        assert np.mean(first == second) < 0.001
    begun = points.onward(index, dr.opaque(mi.UInt32, 0), dr.opaque(mi.Bool, True))[0]
    assert np.array_equal(np.array(begun)[:-1], np.array(points.pixel(index)[0])[1:])
