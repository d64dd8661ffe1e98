"""Blur of light next to edges: the integral of a blurred square over pixels has a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.blur import blur
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.perturbation.edge_blur import build_edge_blur
from cboxlab.rendering.perturbation.warp import build_warp
from cboxlab.rendering.visibility.tracer import build_tracer
from helpers.scenes.boxes import BANDS, camera_inside, lamp_and, quad, square
from scipy.special import erf

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: a picture is rendered")

PLACES = np.array([[300.0, 300.0, 900.0], [512.3, 691.7, 900.0], [733.1, 411.9, 900.0]])
HALF = 61.7
BRIGHT = (1.0, 3.0)


@pytest.fixture(scope="module")
def squares():
    """Three squares that face a camera, signals 1 and 3 in two bands, in the dark; and their borders, px."""
    marks = [quad(f"mark-{i}", square(p, HALF, 2, -1)) for i, p in enumerate(PLACES)]
    scene = lamp_and(marks, square(np.array([500.0, 2000.0, 500.0]), 10.0, 1, -1))
    camera = replace(camera_inside(48, z=-700.0, focal=1.3), principal_point_px=np.array([23.2, 23.9]))
    image = render_path_tracer(RenderJob(scene, camera, BANDS[:1], samples=4, batches=1))
    coverage = image.coverage.sum(axis=-1)
    signal = np.stack([level * coverage for level in BRIGHT])
    warp = build_warp(build_tracer(scene), camera, image, signal)
    corners = [camera.project(p + np.array([[-HALF, -HALF, 0], [HALF, HALF, 0]])) for p in PLACES]
    return warp, [(np.sort(c[:, 0]), np.sort(c[:, 1])) for c in corners]


def profile(borders, size, sigma):
    """(size,) integral over each pixel of a step up and down again, blurred; without blur for sigma 0."""

    def step_integral(x):
        if sigma == 0:
            return np.maximum(x, 0)
        z = x / (sigma * np.sqrt(2))
        return x * (1 + erf(z)) / 2 + sigma * np.exp(-(z**2)) / np.sqrt(2 * np.pi)

    low, high = np.arange(size) - 0.5, np.arange(size) + 0.5
    up, down = (step_integral(high - b) - step_integral(low - b) for b in borders)
    return up - down


def truth(borders, size, sigma):
    return sum(np.outer(profile(v, size, sigma), profile(u, size, sigma)) for u, v in borders)


@pytest.mark.parametrize(
    ("sigma", "of_light", "of_pixels"),
    [(0.06, 0.4, 0.8), (0.1, 0.15, 0.7), (0.2, 0.05, 0.5), (0.4, 0.03, 0.3), (0.8, 0.01, 0.06)],
)
def test_blurred_squares_have_their_closed_form(squares, sigma, of_light, of_pixels):
    """Error over change, rms: small with the edges' places in the pixels, much larger from pixels alone.

    Subpixels are an eighth of a pixel wide; pixels' blur is by the kernel that is best for edges at random places.
    """
    warp, borders = squares
    size = warp.camera.width_px
    sharp, expected = truth(borders, size, 0), truth(borders, size, sigma)
    pixels = blur(sharp, sigma)
    change = np.linalg.norm(expected - sharp)
    beyond = build_edge_blur(warp).beyond_pixels(np.full(len(BRIGHT), sigma))
    for level, of_band in zip(BRIGHT, beyond, strict=True):
        assert np.linalg.norm(pixels + of_band / level - expected) < of_light * change
    assert np.linalg.norm(pixels - expected) > of_pixels * change


def test_every_band_has_its_own_blur_and_none_changes_nothing(squares):
    edges = build_edge_blur(squares[0])
    both, sharp = edges.beyond_pixels(np.array([0.2, 0.5])), edges.beyond_pixels(np.zeros(2))
    np.testing.assert_array_equal(both[0], edges.beyond_pixels(np.full(2, 0.2))[0])
    np.testing.assert_array_equal(both[1], edges.beyond_pixels(np.full(2, 0.5))[1])
    assert not sharp.any()


@pytest.mark.parametrize("sigma", [0.07, 0.3, 1.0])
def test_light_is_neither_made_nor_lost(squares, sigma):
    """Faces of one even signal: what leaves a pixel arrives in others, to single precision."""
    warp = squares[0]
    even = replace(warp, layers=np.ones_like(warp.layers))
    change = build_edge_blur(even).beyond_pixels(np.full(2, sigma))
    assert np.abs(change.sum(axis=(1, 2))).max() < 1e-5 * np.abs(change).sum(axis=(1, 2)).max()
