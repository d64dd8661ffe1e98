"""The film without distortion that stands in for a camera's image, and the way back to the camera's pixels."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.visibility.pinhole import _image_of_pixels, film_for, resampling
from cboxlab.scenes import cornell_camera

WIDTH, HEIGHT = 40, 28


def camera(k1):
    principal = np.array([21.3, 11.9])
    return replace(cornell_camera(WIDTH), height_px=HEIGHT, principal_point_px=principal, k1=k1)


@pytest.mark.parametrize("k1", [-0.15, 0.2])
@pytest.mark.parametrize("oversampling", [1, 3])
def test_the_film_is_the_smallest_that_covers_the_image(k1, oversampling):
    """Corners of all pixels lie on the film, which ends less than one of its pixels beyond the outermost corner."""
    lens_camera = camera(k1)
    film = film_for(lens_camera, oversampling)
    assert film.scale == oversampling * lens_camera.focal_length_px
    u, v = np.meshgrid(np.arange(WIDTH + 1) - 0.5, np.arange(HEIGHT + 1) - 0.5)
    right, down, forward = lens_camera.rotation @ lens_camera.directions(u.ravel(), v.ravel()).T
    for axis, slope in enumerate((right / forward, down / forward)):
        position = (slope - film.low[axis]) * film.scale
        assert position.min() == pytest.approx(0, abs=1e-9)
        assert film.size[axis] - 1 < position.max() <= film.size[axis]


def test_without_distortion_its_pixels_are_parts_of_the_cameras():
    film = film_for(camera(0.0), 2)
    assert tuple(film.size) == (2 * WIDTH, 2 * HEIGHT)
    first = film.centres()[0] * camera(0.0).focal_length_px + camera(0.0).principal_point_px
    assert first == pytest.approx([-0.25, -0.25])
    weights = resampling(film, camera(0.0)).toarray()
    row, column = np.divmod(np.arange(film.pixels), 2 * WIDTH)
    sampled = np.zeros_like(weights)
    sampled[row // 2 * WIDTH + column // 2, np.arange(film.pixels)] = 0.25
    np.testing.assert_allclose(weights, sampled, atol=1e-9)


@pytest.mark.parametrize("k1", [-0.15, -0.4])
def test_there_is_no_image_where_rays_farther_out_come_back(k1):
    """r (1 + k1 r^2) grows until 1 + 3 k1 r^2 is 0."""
    radius = np.array([0.1, 0.999, 1.001, 1.1, 2.0]) / np.sqrt(-3 * k1)
    angle = np.arange(5.0)
    xy = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert _image_of_pixels(film_for(camera(k1), 1), camera(k1), xy)[0].tolist() == [True, True, False, False, False]
