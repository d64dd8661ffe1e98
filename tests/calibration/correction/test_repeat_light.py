"""Photon transfer where the light changes between repeats: the gain stays right, and steady light raises no note."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.correction.repeat_light import (
    LIGHT_CHANGE_NOTED,
    LIGHT_FALSE_ALARM,
    light_change,
    with_steady_light,
)
from cboxlab.calibration.detector.photon_transfer import frame_statistics, transfer
from helpers.fakes.capture import BIAS, GAIN, FakeCapture
from scipy.stats import poisson

K, LEVEL_E, READ_E = 1 / 12.0, 24000.0, 10.0


def field(size, depth):
    """(y, x) a field that falls off by ``depth`` towards its corners."""
    v, u = np.mgrid[:size, :size] / (size - 1) - 0.5
    return 1 - depth * (u**2 + v**2) * 2


def frame(rng, electrons):
    charge = rng.poisson(electrons) + READ_E * rng.standard_normal(electrons.shape)
    return np.clip(np.rint(60 + K * charge), 0, 4095).astype(np.uint16)


def pulls(light, repeats, depth=0.4, size=96, seeds=24):
    """Deviation of the gain in its standard deviations, for ``light`` of each repeat."""
    values = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        dark = frame_statistics(
            np.stack([frame(rng, np.zeros((size, size))) for _ in range(repeats)]), 4095, flatten=False
        )
        bright = np.stack([frame(rng, LEVEL_E * factor * field(size, depth)) for factor in light])
        sensor = transfer(dark, [frame_statistics(bright, 4095, flatten=True)], 4095)
        values.append((sensor.gain_dn_per_e - K) / sensor.gain_sigma)
    return np.array(values)


@pytest.mark.parametrize(
    "light",
    [(1, 1), (1, 1.0025), (1, 1.01), (1, 0.95), (1, 1.01, 1.02), (1, 1.02, 1, 0.98)],
    ids=str,
)
@pytest.mark.parametrize("depth", [0.0, 0.8])
def test_the_gain_does_not_depend_on_the_light_of_single_repeats(light, depth):
    """Each pull is standard normal: the mean of 24 lies within 0.8 of 0 but for one set in 11,000."""
    values = pulls(light, len(light), depth)
    assert abs(values.mean()) < 0.8 and np.std(values) < 1.6


def test_shifted_repeats_would_not_do():
    """What scaling is for: with a shift alone two frames that differ by 2 % give a gain 9 sigma off."""
    rng = np.random.default_rng(0)
    pair = np.stack([frame(rng, LEVEL_E * factor * field(256, 0.4)) for factor in (1, 1.02)]).astype(float)
    good = np.ones(pair.shape[1:], bool)
    shifted = pair - (pair - pair.mean(axis=0)).mean(axis=(1, 2))[:, None, None]
    assert shifted.var(axis=0, ddof=1).mean() > 1.02 * with_steady_light(pair, good).var(axis=0, ddof=1).mean()


def test_steady_repeats_are_only_shifted():
    rng = np.random.default_rng(3)
    stack = np.stack([frame(rng, LEVEL_E * field(64, 0.4)) for _ in range(3)]).astype(float)
    good = np.ones(stack.shape[1:], bool)
    expected = stack - (stack - stack.mean(axis=0))[:, good].mean(axis=1)[:, None, None]
    np.testing.assert_array_equal(with_steady_light(stack, good), expected)


def test_the_mean_of_the_repeats_stays():
    rng = np.random.default_rng(4)
    stack = np.stack([frame(rng, LEVEL_E * factor * field(64, 0.4)) for factor in (1, 1.03, 0.99)]).astype(float)
    steady = with_steady_light(stack, np.ones(stack.shape[1:], bool))
    np.testing.assert_allclose(steady.mean(axis=0), stack.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize("change", [0.0035, 0.01, 0.05])
@pytest.mark.parametrize("depth", [0.0, 0.8])
def test_a_change_is_measured(change, depth):
    rng = np.random.default_rng(5)
    stack = np.stack([frame(rng, LEVEL_E * factor * field(256, depth)) for factor in (1, 1 + change)]).astype(float)
    good = np.ones(stack.shape[1:], bool)
    expected = change / (1 + change / 2)  # over the mean of both
    assert light_change(stack, np.full(good.shape, 60.0), good) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(("size", "electrons", "repeats"), [(10, 300, 2), (10, 300, 4), (12, 1500, 2), (8, 30, 3)])
def test_steady_light_raises_no_note(size, electrons, repeats):
    """Frames so small and dark that noise alone exceeds 0.3 % in most of them: alarms are as rare as stated."""
    rng = np.random.default_rng(size + repeats)
    trials, alarms, beyond = 1500, 0, 0
    dark, good = np.full((size, size), 60.0), np.ones((size, size), bool)
    shape = field(size, 0.4)
    for _ in range(trials):
        stack = np.stack([frame(rng, electrons * shape) for _ in range(repeats)]).astype(float)
        means = stack.mean(axis=(1, 2)) - 60
        beyond += np.ptp(means) / means.mean() >= LIGHT_CHANGE_NOTED
        alarms += light_change(stack, dark, good) >= LIGHT_CHANGE_NOTED
    assert beyond > 0.1 * trials
    assert alarms <= poisson.isf(1e-4, LIGHT_FALSE_ALARM * trials)


@pytest.mark.parametrize("change", [0.005, 0.017, 0.3])
def test_a_change_is_measured_in_a_dark_scene_with_a_bright_lamp(change):
    """The lamp's pixels differ by many standard deviations of the others: they are light all the same."""
    rng = np.random.default_rng(9)
    scene = 2000 * field(192, 0.9)
    scene[:12, 80:120] = 36000
    stack = np.stack([frame(rng, factor * scene) for factor in (1, 1 + change)]).astype(float)
    good = np.ones(stack.shape[1:], bool)
    assert light_change(stack, None, good) == pytest.approx(change / (1 + change / 2), rel=0.05, abs=3e-4)
    assert light_change(stack + np.array([0, 40.0])[:, None, None], None, good) == light_change(stack, None, good)


def test_an_offset_that_varies_is_no_light_of_a_scene():
    rng = np.random.default_rng(10)
    stack = np.stack([frame(rng, LEVEL_E * field(96, 0.9)) for _ in range(2)]).astype(float)
    stack[1] += 12
    assert light_change(stack, None, np.ones(stack.shape[1:], bool)) == 0


def test_cosmic_rays_are_no_change_of_the_light():
    rng = np.random.default_rng(6)
    stack = np.stack([frame(rng, LEVEL_E * field(48, 0.4)) for _ in range(2)]).astype(float)
    good = np.ones(stack.shape[1:], bool)
    stack[1].flat[rng.choice(stack[1].size, 16, replace=False)] += 1900
    means = stack.mean(axis=(1, 2)) - 60
    assert np.ptp(means) / means.mean() > LIGHT_CHANGE_NOTED
    assert light_change(stack, np.full(good.shape, 60.0), good) < LIGHT_CHANGE_NOTED


def test_copies_and_dark_frames_are_no_change():
    copies = np.full((3, 20, 20), 700.0)
    good = np.ones((20, 20), bool)
    assert light_change(copies, np.full((20, 20), 60.0), good) == 0
    assert light_change(copies, np.full((20, 20), 700.0), good) == 0
    assert light_change(copies, np.full((20, 20), 60.0), ~good) == 0


@pytest.fixture
def folder(tmp_path):
    return FakeCapture(tmp_path / "capture", height=96, width=112, centres=(450, 550)).write()


def brighten(folder, name, factor):
    counts = tifffile.imread(folder / name).astype(float)
    scaled = np.rint(BIAS + factor * (counts - BIAS))
    tifffile.imwrite(folder / name, np.clip(scaled, 0, 4095).astype(np.uint16))


def light_notes(folder):
    capture = load_capture(folder)
    noise = measure_noise(capture, read_darks(capture))
    return noise, [note for note in noise.notes if "light of the" in note]


@pytest.mark.parametrize(("frame", "word"), [("flat-f550-1", "flat"), ("f550-1", "scene")])
def test_a_capture_says_whose_light_changes(folder, frame, word):
    assert light_notes(folder)[1] == []
    brighten(folder, f"frames/{frame}.tif", 1.02)
    noise, notes = light_notes(folder)
    assert len(notes) == 1 and notes[0].startswith(f"f550: the light of the {word} changes by 2")
    limits = [note for note in noise.notes if "look alike in 2 further repeats" in note]
    assert len(limits) == (word == "scene")
    assert abs(noise.gain_e_per_dn - GAIN) < 4 * noise.gain_sigma
