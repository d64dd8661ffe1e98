"""Frames of unlike colours against a rendering: half a pixel is measured, and named with the frames it divides."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.validation.capture_checks.band_registration import _check_scene_step
from cboxlab.validation.capture_checks.scene_shifts import SceneShifts, scene_shifts

SIDE, FINE = 48, 8
#: Reflectances of five things, by band.
COLOURS = np.random.default_rng(1).uniform(0.05, 0.8, (3, 5))


def picture(band, moved_px, size=1.0):
    """(y, x) a wall with four rectangles, moved along the rows and enlarged; each pixel has the mean of 64."""
    v, u = (np.indices((SIDE * FINE, SIDE * FINE)) + 0.5) / FINE - 0.5
    middle = (SIDE - 1) / 2
    v, u = middle + (v - middle) / size, middle + (u - moved_px - middle) / size
    surface = np.zeros(u.shape, int)
    for index, (left, top, right, bottom) in enumerate([(5, 6, 17, 22), (24, 4, 40, 15), (7, 28, 19, 41)], 1):
        surface[(u > left) & (u < right) & (v > top) & (v < bottom)] = index
    surface[np.abs(0.9 * (u - 32.3) + 0.4 * (v - 31.7)) + np.abs(0.9 * (v - 31.7) - 0.4 * (u - 32.3)) < 9] = 4
    light = COLOURS[band][surface] * (1 - 0.005 * v)
    return light.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))


def shifts_of(moved_px, pattern=None, size=1.0, noise=0.01, seed=1):
    """Shifts of three bands that were moved by so much; the rendering has one ray a pixel."""
    rng = np.random.default_rng(seed)
    relative = np.stack([1.01 * picture(band, moved, size) for band, moved in enumerate(moved_px)])
    relative = relative + noise * rng.standard_normal(relative.shape)
    v, u = np.indices((SIDE, SIDE))
    mask = np.zeros(relative.shape, np.uint8)
    if pattern is not None:
        mask = np.stack([pattern[v % 2, u % 2] != channel for channel in range(3)])
    preview = SimpleNamespace(
        radiance=np.stack([picture(band, 0.0) for band in range(3)]), on_surface=np.ones((SIDE, SIDE), bool), step=1
    )
    bands = SimpleNamespace(images=xr.Dataset({"mask": (("band", "y", "x"), mask.astype(np.uint8))}))
    view = SimpleNamespace(preview=preview, relative=relative)
    return scene_shifts(bands, view, None if pattern is None else (2, 2))


@pytest.mark.parametrize("pattern", [None, np.array([[0, 1], [1, 2]])], ids=["monochrome", "mosaic"])
def test_each_band_has_its_shift_whatever_its_colours(pattern):
    moved = np.array([0.0, 0.5, -0.4])
    shifts = shifts_of(moved, pattern)
    allowed = 0.06 if pattern is None else 0.15
    np.testing.assert_allclose(shifts.shift_px[:, 0], moved, atol=allowed)
    np.testing.assert_allclose(shifts.shift_px[:, 1], 0, atol=allowed)
    assert np.all(shifts.sigma_px < allowed)


@pytest.mark.parametrize("size", [0.97, 1.0, 1.03])
def test_the_size_of_a_photograph_is_measured_behind_a_mosaic(size):
    shifts = shifts_of(np.zeros(3), np.array([[0, 1], [1, 2]]), size)
    np.testing.assert_allclose(shifts.enlargement, size - 1, atol=0.01)


def capture(frames):
    bands = [SimpleNamespace(frames=(name,)) for name in frames]
    ids = tuple(f"b{index}" for index in range(len(frames)))
    return SimpleNamespace(manifest=SimpleNamespace(band=bands), band_ids=ids)


def step(frames, moved_px, seed=0, scatter=0.05):
    rng = np.random.default_rng(seed)
    shift = np.stack([moved_px, np.zeros(len(frames))], axis=1) + scatter * rng.standard_normal((len(frames), 2))
    return [*_check_scene_step(capture(frames), SceneShifts(shift, np.full(len(frames), 0.04), np.zeros(len(frames))))]


@pytest.mark.parametrize("after", [1, 3, 6])
def test_a_movement_is_named_with_the_frames_before_and_after_it(after):
    (suspicion,) = step("abcdefg", np.where(np.arange(7) < after, 0.0, 0.5))
    assert f"between b{after - 1} and b{after}" in suspicion.what
    assert ("one filter" in suspicion.what) is (after in (1, 6))
    assert float(re.search(r"\(([+-][\d.]+),", suspicion.why)[1]) == pytest.approx(0.5, abs=0.15)


def test_channels_of_a_frame_move_together():
    (suspicion,) = step("aaabbb", np.repeat([0.0, 0.5], 3))
    assert "between b0, b1, b2 and b3, b4, b5" in suspicion.what


def test_frames_that_scatter_did_not_move():
    """A camera that stood still, in 200 captures of each kind; frames scatter by up to 0.07 px."""
    frames = ("abcdefg", "abcd", "aaabbb")
    assert not [s for seed in range(200) for f in frames for s in step(f, np.zeros(len(f)), seed, 0.07)]
