"""Soft corners: the moments of the spots that they make of a point."""

from types import SimpleNamespace

import numpy as np
from cboxlab.scenes import cornell_camera
from cboxlab.validation.diagnose.base_flaws import lens

SIZE = 12
CAMERA = cornell_camera(SIZE)


def test_spots_have_their_variance_at_each_distance_from_the_axis(monkeypatch):
    """A blur of variance s^2 adds s^2 to the square of a coordinate. Lines point to the axis, round spots nowhere."""
    rows, columns = np.indices((SIZE, SIZE)) - np.reshape(CAMERA.principal_point_px[::-1], (2, 1, 1))
    distance = np.hypot(rows, columns)
    distance /= distance.max()

    def change(warp, camera):
        """Of the squares of both coordinates, one a band, by another focal length."""
        size = camera.focal_length_px / CAMERA.focal_length_px
        return np.array([columns**2, rows**2]) * (1 / size**2 - 1)

    monkeypatch.setattr(lens, "warp_change", change)
    blurred, used = np.full((2, SIZE, SIZE), 0.25**2), np.ones((2, SIZE, SIZE), bool)
    columns_of = lens.soft_corners(blurred, used, SimpleNamespace(camera=CAMERA), 3.0)
    forms, changes = zip(*((form, c.reshape(used.shape)) for form, c in columns_of), strict=True)
    assert forms == (*3 * ("lens:round",), *2 * ("lens:radial",))
    for power, spot in zip((2, 4, 8), changes, strict=False):
        np.testing.assert_allclose(spot, np.broadcast_to((0.25 * distance**power) ** 2, spot.shape))
    for power, (across, down) in zip((1, 2), changes[3:], strict=True):
        # the variance of a line along each coordinate is its share of the direction
        length, angle = 0.25 * distance**power, np.arctan2(rows, columns)
        np.testing.assert_allclose(across, 3 * (length * np.cos(angle)) ** 2, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(down, 3 * (length * np.sin(angle)) ** 2, rtol=1e-9, atol=1e-15)
