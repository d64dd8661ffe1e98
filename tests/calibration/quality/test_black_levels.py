"""A stated black level that does not suit the noise is named with its error; right ones and bent counts are not."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.correction import NoiseModel
from cboxlab.calibration.quality.frame_checks.counts import check_black_levels
from cboxlab.calibration.quality.frame_checks.stacks import Stack

SIDE, GAIN, READ_E, BLACK = 96, 10.0, 11.0, 100.0
PLACES = {"R": [(0, 0)], "G": [(0, 1), (1, 0)], "B": [(1, 1)]}


def suspicions(seed, levels=BLACK, bend=0.0, mosaic=True):
    """Suspicions of two repeats of a picture whose darkest pixels have a fiftieth of the light of the brightest."""
    rng = np.random.default_rng(seed)
    light, response = 2500 * np.geomspace(0.02, 1, SIDE) * np.ones((SIDE, 1)), np.ones((SIDE, SIDE))
    stated_dn = np.full((SIDE, SIDE), levels if isinstance(levels, float) else BLACK)
    for channel, share in zip(PLACES, (0.5, 1.0, 0.3), strict=True):
        for row, column in PLACES[channel] if mosaic else []:
            response[row::2, column::2] = share
            stated_dn[row::2, column::2] = levels if isinstance(levels, float) else levels.get(channel, BLACK)
    electrons = rng.poisson(GAIN * light * response, (2, SIDE, SIDE)) + READ_E * rng.standard_normal((2, SIDE, SIDE))
    counts = BLACK + electrons / GAIN
    frames = np.clip(np.rint(counts * (1 + bend * counts / 4095)), 0, 4095).astype(np.uint16)
    channels = [*PLACES] if mosaic else [None]
    stacks = [Stack("band", f"band ({c})", c, 1.0, None, ("0", "1"), frames, None, c) for c in channels]
    camera = SimpleNamespace(gain_e_per_dn=GAIN, read_noise_e=READ_E, black_level_dn=levels)
    manifest = SimpleNamespace(camera=camera, mosaic=SimpleNamespace(pattern="RGGB") if mosaic else None)
    capture = SimpleNamespace(manifest=manifest, shape=(SIDE, SIDE), saturation_dn=4095, full_scale_dn=4095)
    dark = SimpleNamespace(exposure_s=np.zeros(0), bias=stated_dn, at=lambda _: stated_dn)
    return [*check_black_levels(capture, stacks, dark, NoiseModel(GAIN, 0.1, READ_E, 0.1))]


@pytest.mark.parametrize("channel", [*PLACES])
@pytest.mark.parametrize("share", [0.75, 1.25])
def test_a_level_of_one_channel_that_is_off_by_a_quarter_is_named(channel, share):
    (suspicion,) = suspicions(1, {**dict.fromkeys(PLACES, BLACK), channel: share * BLACK})
    assert suspicion.what == f"the black level of {channel} is too {'low' if share < 1 else 'high'}"
    error, sigma = re.search(r"it is ([-+][\d.]+) \+- ([\d.]+) DN", suspicion.why).groups()
    assert abs(float(error) - (share - 1) * BLACK) < 4 * float(sigma) < 0.3 * BLACK


@pytest.mark.parametrize("mosaic", [True, False])
def test_a_level_of_all_pixels_that_is_too_low_is_named(mosaic):
    (suspicion,) = suspicions(2, 0.75 * BLACK, mosaic=mosaic)
    assert suspicion.what == "the black level is too low" and suspicion.where == "camera.black_level_dn"


@pytest.mark.parametrize("bend", [0.0, 0.05, -0.05])
def test_right_levels_are_sound_even_where_counts_bend(bend):
    assert not [s for seed in range(6) for mosaic in (True, False) for s in suspicions(seed, BLACK, bend, mosaic)]
