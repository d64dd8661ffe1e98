"""Camera rays in single precision against the camera's own directions, with and without distortion."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import device_array, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility import pixel_rays
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.lens import Lens

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

WIDTH, HEIGHT = 60, 44
PIXEL = np.arange(WIDTH * HEIGHT)
RANDOM = np.random.default_rng(5).random((2, PIXEL.size)).astype(np.float32)


def camera(k1, lens):
    principal = np.array([31.2, 20.4])
    return replace(cornell_camera(WIDTH), height_px=HEIGHT, principal_point_px=principal, k1=k1, lens=lens)


@pytest.mark.parametrize(
    ("k1", "lens"),
    [
        (0.0, Lens()),
        (-0.5, Lens()),
        (0.8, Lens()),
        (-0.2, Lens(k2=0.4, k3=-0.3, p1=0.01, p2=-0.02, aspect=1.05)),
        (-0.04, Lens("fisheye", k2=0.02, k3=-0.01, k4=0.003, aspect=0.95)),
    ],
)
def test_a_ray_goes_where_its_place_in_the_pixel_says(k1, lens):
    """To 2e-5 of a pixel, wherever in the pixel: half a pixel to the left of its centre is its border."""
    lens_camera = camera(k1, lens)
    rays = pixel_rays(lens_camera, device_array(mi.UInt32, PIXEL))(*(device_array(mi.Float, x) for x in RANDOM))
    direction = np.array(rays.d).T @ lens_camera.rotation.T
    row, column = np.divmod(PIXEL, WIDTH)
    expected = lens_camera.directions(column + RANDOM[0] - 0.5, row + RANDOM[1] - 0.5) @ lens_camera.rotation.T
    off = direction[:, :2] / direction[:, 2:] - expected[:, :2] / expected[:, 2:]
    assert np.abs(off).max() * lens_camera.focal_length_px < 2e-5
    np.testing.assert_allclose(np.array(rays.o).reshape(3, -1)[:, 0], lens_camera.position_mm, rtol=1e-6)
