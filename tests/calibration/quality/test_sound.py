"""Numbers that vary from band to band by chance raise no suspicion."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks
from cboxlab.calibration.quality.frame_checks.fingerprint import check_flat_shapes
from cboxlab.calibration.quality.frame_checks.stacks import read_stacks
from cboxlab.calibration.quality.levels import check_constant, check_flats_and_references
from cboxlab.calibration.radiometry import measure_constant
from helpers.places import ROOT

LEVELS = {
    # four of seven bands agree with the median by chance: sources that are set again in each band
    "another level in each band": ([1.03, 1.0, 0.88, 0.93, 1.01, 1.0, 0.6], set()),
    # one source for all: one of them is another frame
    "one frame of another band": ([1.0, 1.0, 1.0, 0.88, 1.0, 1.0, 1.0], {3}),
}


@pytest.mark.parametrize("name", LEVELS)
def test_only_where_most_flats_agree_one_that_does_not_is_suspected(name):
    levels, wrong = LEVELS[name]
    capture = load_capture(ROOT / "validate" / "data" / "demo-capture")
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    bands = correct_bands(capture, dark, noise)
    radiometry = measure_constant(capture, bands, dark, noise)
    flats = {
        band: replace(flat, mean_dn=level * flat.mean_dn)
        for (band, flat), level in zip(bands.flats.items(), levels, strict=True)
    }
    results = [*check_flats_and_references(capture, replace(bands, flats=flats), radiometry, None)]
    assert {s.where for s in results} == {f"flat ({[*flats][index]})" for index in wrong}


def test_constants_off_by_reciprocal_factors_are_no_exchange():
    """Pass bands of narrow filters move towards the edge of the field: a few per cent, up in one, down in another."""
    capture = load_capture(ROOT / "validate" / "data" / "demo-capture")
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    radiometry = measure_constant(capture, correct_bands(capture, dark, noise), dark, noise)
    levels = [0.95, *[1.0] * (len(radiometry.by_band) - 2), 1 / 0.95]
    by_band = tuple(
        replace(c, constant=level * radiometry.constant) for c, level in zip(radiometry.by_band, levels, strict=True)
    )
    assert not [*check_constant(capture, replace(radiometry, by_band=by_band), noise, None, None)]


def test_hot_pixels_that_saturate_the_sums_of_a_flat_are_no_picture():
    """Blocks of a large frame have sums far below the count that marks them as saturated; a scene stays a picture."""
    capture, largest = load_capture(ROOT / "validate" / "data" / "demo-capture"), 2**24
    dark = read_darks(capture)
    stacks = read_stacks(capture)
    scene = next(stack for stack in stacks if stack.kind == "band")
    flat = next(stack for stack in stacks if stack.kind == "flat" and stack.band == scene.band)
    hot = np.random.default_rng(1).random(capture.shape) < 0.04

    def suspicions(frames):
        saturated = np.where(hot, largest, frames.astype(np.uint32))
        return [*check_flat_shapes([replace(flat, frames=saturated)], dark, largest)]

    assert not suspicions(flat.frames)
    assert "show a picture" in suspicions(scene.frames)[0].what
