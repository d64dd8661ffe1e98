"""Photographs that were divided by their flats, and dark frames of another temperature; sound ones are neither."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.quality.frame_checks.dark_light import check_dark_temperature
from cboxlab.calibration.quality.frame_checks.fingerprint import check_division, surroundings
from cboxlab.calibration.quality.frame_checks.stacks import Stack
from scipy.ndimage import gaussian_filter

GAIN, READ_DN, BIAS, FULL = 12.0, 0.8, 100.0, 4095
BANDS = {"a": 0.3, "b": 8.0, "c": 0.5, "d": 2.0, "e": 0.3, "f": 1.0}


def laboratory(seed, size=64, divisions=0, warmer=1.0, sensitivity=0.006, hot=6):
    """Stacks of six bands with flats and darks, and the levels of the darks.

    divisions : of the photographs by their flats. warmer : dark current of the dark frames over that of the others.
    """
    draw = np.random.default_rng(seed)
    prnu = 1 + sensitivity * draw.standard_normal((size, size))
    rate = 0.5 * np.exp(0.1 * draw.standard_normal((size, size)))
    rate.flat[draw.choice(size * size, hot, replace=False)] *= draw.uniform(10, 60, hot)
    scene = np.kron(draw.uniform(0.05, 1.0, (4, 4)), np.ones((size // 4, size // 4)))
    scene = gaussian_filter(scene, 0.7) * np.linspace(0.7, 1.0, size)

    def frames(light, exposure_s, charge=1.0, repeats=2):
        electrons = GAIN * (light * prnu + charge * rate * exposure_s)
        shots = draw.poisson(electrons, (repeats, size, size)) / GAIN
        counts = BIAS + shots + READ_DN * draw.standard_normal(shots.shape)
        return np.clip(np.rint(counts), 0, FULL).astype(np.uint16)

    def stack(kind, band, exposure_s, pictures):
        names = tuple(f"{kind}-{band}-{k}" for k in range(len(pictures)))
        return Stack(kind, f"{kind} ({band})", band, exposure_s, None, names, pictures, None)

    stacks, levels = [], {}
    for exposure_s in sorted({*BANDS.values()}):
        dark = frames(np.zeros((size, size)), exposure_s, warmer)
        levels[exposure_s] = dark.mean(axis=0)
        stacks.append(stack("dark", None, exposure_s, dark))
    for band, exposure_s in BANDS.items():
        flat = frames(np.full((size, size), 2500.0), exposure_s)
        picture = frames(3000.0 * scene, exposure_s).astype(float)
        even = flat.mean(axis=0) - levels[exposure_s]
        for _ in range(divisions):
            picture = levels[exposure_s] + (picture - levels[exposure_s]) / (even / even.mean())
        stacks.append(stack("flat", band, exposure_s, flat))
        stacks.append(stack("band", band, exposure_s, np.clip(np.rint(picture), 0, FULL).astype(np.uint16)))
    return stacks, SimpleNamespace(at=lambda exposure_s: levels[exposure_s])


def test_a_quadratic_surface_is_expected_from_its_neighbours_alone():
    v, u = np.mgrid[:12, :12].astype(float)
    surface = 3 + u - 2 * v + 0.1 * u * u - 0.3 * u * v + 0.2 * v * v
    single = surface.copy()
    single[6, 5] += 50
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(surroundings(surface)[inner], surface[inner], atol=1e-12)
    assert surroundings(single)[6, 5] == pytest.approx(surface[6, 5])


def test_sound_captures_raise_no_suspicion():
    """Of 16 captures none, also without pattern, without hot pixels and at 32 px."""
    for seed in range(16):
        changes = ({"size": 48}, {"sensitivity": 0.0, "size": 48}, {"hot": 0, "size": 48}, {"size": 32})[seed % 4]
        stacks, dark = laboratory(seed, **changes)
        assert not [*check_division(stacks, dark), *check_dark_temperature(stacks, FULL)], (seed, changes)


@pytest.mark.parametrize(("divisions", "factor"), [(1, 0.0), (2, -1.0)])
def test_photographs_divided_by_their_flats_are_named_with_the_factor(divisions, factor):
    """A flat's own noise is in the photograph that was divided by it, and in a sixth of the pattern: a little less."""
    for seed in range(3):
        stacks, dark = laboratory(seed, divisions=divisions)
        (suspicion,) = check_division(stacks, dark)
        value, sigma = (float(word) for word in suspicion.why.split("factor of ")[1].split(". ")[0].split(" +- "))
        assert factor - 0.15 * divisions - 3.5 * sigma < value < factor + 3.5 * sigma and sigma < 0.2, suspicion.why
        assert suspicion.where.count("band") == len(BANDS)
        assert not [*check_dark_temperature(stacks, FULL)]


def test_one_band_that_was_divided_is_named_alone():
    stacks, dark = laboratory(3, sensitivity=0.01)
    divided, _ = laboratory(3, divisions=1, sensitivity=0.01)
    mixed = [d if s.key == "band (c)" else s for s, d in zip(stacks, divided, strict=True)]
    (suspicion,) = check_division(mixed, dark)
    assert suspicion.where == "band (c)"


@pytest.mark.parametrize(("warmer", "word"), [(3.0, "warmer"), (0.4, "colder")])
def test_dark_frames_of_another_temperature_are_named_with_the_factor(warmer, word):
    for seed in range(3):
        stacks, dark = laboratory(seed, warmer=warmer, hot=20)
        (suspicion,) = check_dark_temperature(stacks, FULL)
        value, sigma = (float(part) for part in suspicion.why.split("factor of ")[1].split(" of what")[0].split(" +- "))
        assert word in suspicion.what and abs(value - 1 / warmer) < 4 * sigma + 0.1 / warmer, suspicion.why
        assert not [*check_division(stacks, dark)]


def test_hot_pixels_that_fill_in_the_longest_dark_frames_are_no_other_temperature():
    """Their charge stops at full scale, so that the darks would seem colder."""
    stacks, _ = laboratory(4, hot=20)
    assert not [*check_dark_temperature(stacks, FULL)]
    for stack in stacks:
        np.minimum(stack.frames, 200, out=stack.frames)
    assert not [*check_dark_temperature(stacks, 200)]


def test_one_pixel_whose_charge_comes_and_goes_is_no_other_temperature():
    stacks, _ = laboratory(5, hot=1)
    darks = [stack for stack in stacks if stack.kind == "dark"]
    hot = np.unravel_index(int(darks[-1].mean.argmax()), darks[-1].mean.shape)
    for stack in stacks:
        if stack.kind != "dark":
            stack.frames[:, *hot] = stack.frames[:, hot[0], hot[1] - 1]
    assert not [*check_dark_temperature(stacks, FULL)]
