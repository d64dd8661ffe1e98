"""Frames that a camera averaged, sharpened or corrected; sound ones are none of these."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.quality.frame_checks.counts import check_counts
from cboxlab.calibration.quality.frame_checks.fields import check_fields
from cboxlab.calibration.quality.frame_checks.repeats import (
    _averaged_kinds,
    _is_sharpened,
    _neighbour_correlation,
    check_independence,
    check_repeats,
)
from cboxlab.calibration.quality.frame_checks.stacks import read_stacks
from helpers.places import ROOT
from scipy.ndimage import gaussian_filter


@cache
def sound():
    """Capture, stacks, darks and noise of the bundled capture."""
    capture = load_capture(ROOT / "validate" / "data" / "demo-capture")
    dark = read_darks(capture)
    return capture, read_stacks(capture), dark, measure_noise(capture, dark)


def changed(change, kinds=("band",), bands=None):
    """The stacks, with ``change`` of the counts (repeat, y, x) of some."""
    capture, stacks, *_ = sound()

    def spoilt(stack):
        counts = np.rint(change(stack.frames.astype(float)))
        return replace(stack, frames=np.clip(counts, 0, capture.full_scale_dn).astype(np.uint16))

    return tuple(
        spoilt(stack) if stack.kind in kinds and (bands is None or stack.band in bands) else stack for stack in stacks
    )


def averaged(number):
    """Change that leaves the mean of the repeats and divides the variance by ``number``."""
    return lambda counts: counts.mean(axis=0) + (counts - counts.mean(axis=0)) / np.sqrt(number)


@pytest.mark.parametrize(("kind", "number"), [("band", 2), ("band", 4), ("flat", 3), ("band", 1)])
def test_averages_that_are_not_stated_are_named_with_their_kind(kind, number):
    capture, _, dark, noise = sound()
    stacks = changed(averaged(number), (kind,))
    alarms = [s for s in check_repeats(capture, stacks, dark, noise) if "average of several" in s.what]
    assert [alarm.where for alarm in alarms] == ([f"{kind}.frames"] if number > 1 else [])
    assert all(f"about {number}" in alarm.what for alarm in alarms)


def test_a_flicker_of_the_scene_does_not_make_the_flats_averages():
    capture, _, dark, noise = sound()
    stacks = changed(averaged(1 / 2.5))
    assert not [s for s in check_repeats(capture, stacks, dark, noise) if "average of several" in s.what]


@pytest.mark.parametrize(
    ("bands", "flats", "bins", "kinds"),
    [
        ([0.5, 0.48, 0.52], [1.0, 1.1, 0.9], [0.5, 0.5, 0.5], {"band"}),
        ([0.5, 0.48, 0.52], [0.5, 0.51, 0.5], [0.5, 0.5, 0.5], set()),  # a wrong gain
        ([0.3, 0.5, 0.6], [1.0, 1.1, 0.9], [0.5, 0.5, 0.5], set()),  # not one number of averaged frames
        ([0.5, 0.48, 0.52], [1.0, 1.1, 0.9], [0.5, 0.5, 1.0], set()),  # as noisy as stated where it is bright
        ([0.5, 0.48], [1.0, 1.1, 0.9], [0.5, 0.5, 0.5], set()),  # too few
    ],
)
def test_averages_have_one_small_noise_at_all_signals_next_to_a_stated_one(bands, flats, bins, kinds):
    def pairs(kind, misfits, bins):
        return [SimpleNamespace(stack=SimpleNamespace(kind=kind), misfit=m, bins=np.array(bins)) for m in misfits]

    assert set(_averaged_kinds([*pairs("band", bands, bins), *pairs("flat", flats, [1, 1, 1])])) == kinds


def test_neighbours_oppose_each_other_along_rows_and_columns_or_nothing_is_sharpened():
    """Differences of noise along one direction correlate by -1/2 there alone; the limit grows in small pictures."""
    noise = np.random.default_rng(1).standard_normal((120, 120))
    usable = np.ones(noise.shape, bool)
    both = noise - 0.5 * (np.roll(noise, 1, 0) + np.roll(noise, 1, 1))
    assert _neighbour_correlation(noise - np.roll(noise, 1, 1), usable, (1, 1)) == pytest.approx(0, abs=0.03)
    assert _neighbour_correlation(both, usable, (1, 1)) == pytest.approx(-1 / 3, abs=0.03)
    for px, sharpened in ((40, False), (128, True)):
        counts = np.zeros((2, px, px))
        assert _is_sharpened(SimpleNamespace(neighbours=-0.1, stack=SimpleNamespace(counts=counts))) == sharpened


@pytest.mark.parametrize(("amount", "word"), [(1.5, "sharpened"), (-0.7, "smoothed"), (0.0, None)])
def test_sharpened_frames_are_not_smoothed_ones(amount, word):
    """An unsharp mask opposes the noise of neighbours; a blur makes it alike."""
    capture, _, dark, noise = sound()
    stacks = changed(lambda x: x + amount * (x - gaussian_filter(x, (0, 1, 1))), bands=("f600",))
    alarms, tables = check_independence(capture, stacks, dark, noise)
    assert [word in alarm.what and "f600" in alarm.where for alarm in alarms] == ([True] if word else [])
    assert len(tables) == len(alarms)


def test_one_flat_of_another_aperture_is_named_alone():
    capture, stacks, dark, _ = sound()
    v, u = np.mgrid[-1:1:128j, -1:1:128j]
    stacks = changed(lambda counts: 100 + (counts - 100) * (1 - 0.06 * (u * u + v * v)), ("flat",), ("f500",))
    (alarm,) = check_fields(capture, stacks, dark)
    assert alarm.where == "flat (f500), reference (f500)"
    assert "than in the middle" in alarm.why
    assert "6 of 7" in alarm.why
    assert not [*check_fields(capture, sound()[1], dark)]


@pytest.mark.parametrize("is_stated", [True, False])
def test_saturated_pixels_less_their_dark_level_are_no_wrong_bit_depth(is_stated):
    capture, _, dark, noise = sound()
    manifest = capture.manifest.model_copy(update={"dark": "subtracted"}) if is_stated else capture.manifest
    stacks = changed(lambda counts: counts - 100)
    alarms = check_counts(replace(capture, manifest=manifest), stacks, dark, noise)
    assert any("saturation below" in alarm.what for alarm in alarms) != is_stated
