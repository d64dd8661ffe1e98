"""A picture from a slightly moved camera: looked up in the first picture, against rendering it again."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation.warp import build_warp, pixels_per_unit, warp_change, warp_derivatives
from cboxlab.rendering.radiosity.final_gather import gather, solve_light
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import BANDS
from scipy.ndimage import binary_dilation

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

SIZE = 96


@pytest.fixture(scope="module")
def warp():
    light = solve_light(cornell_box(), BANDS[2:], seed=1)
    camera = cornell_camera(SIZE)
    image = gather(light, camera, 256, 1, seed=2)
    signal = np.moveaxis(image.project(np.eye(1))[0], -1, 0)
    return light, image, signal, build_warp(light.tracer, camera, image, signal)


def moved(warp, index, pixels):
    """The camera with one parameter changed so that the scene's corners move by ``pixels`` (rms)."""
    values = warp.camera.parameters.copy()
    values[index] += pixels / pixels_per_unit(warp.tracer, warp.camera)[index]
    return warp.camera.with_parameters(values)


def test_the_same_camera_changes_nothing(warp):
    *_, picture_warp = warp
    assert np.all(warp_change(picture_warp, picture_warp.camera) == 0)
    assert np.all(warp_change(picture_warp, picture_warp.camera.with_parameters(picture_warp.camera.parameters)) == 0)


@pytest.mark.parametrize("index", range(10))
def test_pixels_per_unit_is_how_far_corners_move(warp, index):
    """A parameter changed by 0.3 over its figure moves the corners in sight by 0.3 px rms."""
    *_, picture_warp = warp
    points = picture_warp.tracer.vertices.reshape(-1, 3)
    before, after = picture_warp.camera.project(points), moved(picture_warp, index, 0.3).project(points)
    inside = np.all((before > -0.5) & (before < SIZE), axis=1)
    assert np.sqrt(np.mean(np.sum((after - before)[inside] ** 2, axis=1))) == pytest.approx(0.3, rel=0.01)


def test_pixels_per_unit_of_a_camera_that_sees_no_corner(warp):
    """Near the back wall, and with the box behind it."""
    *_, picture_warp = warp
    near = replace(picture_warp.camera, position_mm=np.array([278.0, 273.0, 500.0]))
    assert np.isfinite(pixels_per_unit(picture_warp.tracer, near)).all()
    with pytest.raises(InputError, match="the scene behind it"):
        pixels_per_unit(picture_warp.tracer, replace(picture_warp.camera, position_mm=np.array([278.0, 273.0, 5000.0])))


def stretched(warp):
    """The camera with a bend that its ten parameters lack: columns slide by up to 0.8 px, 0.36 px rms."""
    middle = (SIZE - 1) / 2
    return warp.camera.distorted_further(
        lambda image_px: 0.8 * ((image_px[:, :1] - middle) / middle) ** 2 * np.array([0.0, 1.0])
    )


@pytest.mark.parametrize("index", [0, 1, 5, 8, "bend"])
def test_a_move_of_a_third_of_a_pixel_is_rendering_again(warp, index):
    """Change looked up against change rendered with the same random numbers.

    Both are noisy, so their sizes are compared (the slope of the major axis), to 4%, and they go together, with
    a correlation above 0.95: what the motion alone brings into sight is not known. Pixels next to the lamp stay
    out: there a rendered pixel's noise is as large as its signal.
    """
    light, image, signal, picture_warp = warp
    camera = stretched(picture_warp) if index == "bend" else moved(picture_warp, index, 0.3)
    again = gather(light, camera, 256, 1, seed=2)
    rendered = np.moveaxis(again.project(np.eye(1))[0], -1, 0) - signal
    far = ~binary_dilation(image.sees_lamp | again.sees_lamp, np.ones((3, 3)))
    looked_up, rendered = warp_change(picture_warp, camera)[:, far].ravel(), rendered[:, far].ravel()
    assert np.corrcoef(looked_up, rendered)[0, 1] > 0.95
    assert np.sqrt(np.mean(looked_up**2) / np.mean(rendered**2)) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("pixels", [0.04, -0.04])
def test_a_wave_moves_as_its_formula_says(warp, pixels):
    """A wave of 13 px across the picture, away from edges, in a picture moved along rows.

    Interpolated, its slope is sin(w) / w of the true one, 4 % less; with straight lines a fourth would be missed.
    """
    _, image, _, picture_warp = warp
    rows, columns = np.mgrid[:SIZE, :SIZE]

    def wave(x):
        return np.cos(0.5 * x + 0.3 * rows)

    waved = build_warp(picture_warp.tracer, picture_warp.camera, image, wave(columns)[None])
    change = warp_change(waved, moved(picture_warp, 7, pixels))[0]
    expected = wave(columns - pixels) - wave(columns)
    inner = np.ones((SIZE, SIZE), bool)
    inner.flat[picture_warp.border] = False
    inner = ~binary_dilation(~inner, np.ones((5, 5)))
    assert inner.sum() > 1000
    assert np.sqrt(np.mean((change - expected)[inner] ** 2) / np.mean(expected[inner] ** 2)) < 0.06


@pytest.mark.parametrize("off", [0.0, 0.2])
def test_derivatives_are_those_of_the_changes(warp, off):
    """By central differences over 0.02 px, at the first camera and a moved one."""
    *_, picture_warp = warp
    camera, steps = moved(picture_warp, 3, off), 0.01 / pixels_per_unit(picture_warp.tracer, picture_warp.camera)
    derivatives = warp_derivatives(picture_warp, camera, steps)
    for derivative, step, row in zip(derivatives, steps, np.diag(steps), strict=True):
        ahead, behind = (
            warp_change(picture_warp, camera.with_parameters(camera.parameters + sign * row)) for sign in (1, -1)
        )
        expected = (ahead - behind) / (2 * step)
        assert np.linalg.norm(derivative - expected) < 1e-3 * np.linalg.norm(expected)
