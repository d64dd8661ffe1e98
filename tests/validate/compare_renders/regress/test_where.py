"""Spot of a difference: its peak, extent and size, and how often noise alone has one."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.where import spot_of
from scipy.ndimage import gaussian_filter

SIZE = 48
LIGHT = 2 + np.linspace(0, 1, SIZE)[:, None] * np.ones(SIZE)
LIT = np.ones((SIZE, SIZE), bool)
NOISE = 0.1
#: Width of a Gaussian pixel filter, and the number of pixels that it makes one.
FILTER_PX = 0.8
ALIKE = 4 * np.pi * FILTER_PX**2


def noise(rng, filtered):
    """(y, x) noise of standard deviation 0.1, with the tails of a difference of two renderings."""
    values = np.subtract(*rng.standard_gamma(4.0, (2, SIZE, SIZE))) / np.sqrt(2)
    values = gaussian_filter(values, FILTER_PX, mode="wrap") * np.sqrt(ALIKE) if filtered else values
    return NOISE / 2 * values


def spot(change, seed=0, filtered=False, **more):
    """Spot of a relative change of the light."""
    difference = change * LIGHT + noise(np.random.default_rng(seed), filtered)
    variance = np.full(LIGHT.shape, NOISE**2)
    return spot_of(difference, LIGHT, variance, LIT, ALIKE if filtered else 1.0, **more)


@pytest.mark.parametrize("filtered", [False, True], ids=["independent", "filtered"])
@pytest.mark.parametrize("sign", [-1, 1], ids=["darker", "brighter"])
def test_a_patch_is_where_it_is(sign, filtered):
    change = np.zeros_like(LIGHT)
    change[30:38, 6:16] = 0.12 * sign
    result = spot(change, filtered=filtered)
    (x, y), (left, top, right, bottom) = result.peak, result.bounds
    assert result.clear
    assert 6 <= x < 16
    assert 30 <= y < 38
    assert np.abs(np.subtract((left, top, right, bottom), (6, 30, 16, 38))).max() <= 4
    assert result.difference == pytest.approx(0.12 * sign, rel=0.35)
    assert np.sign(result.sigmas[y, x]) == sign
    assert "in the lower left part, " in result.sentence
    assert ("brighter" if sign > 0 else "darker") in result.sentence


def test_the_map_is_smoothed_as_wide_as_the_change_is():
    small, wide = np.zeros_like(LIGHT), np.zeros_like(LIGHT)
    small[20:22, 20:22] = 0.4
    wide[8:40, 8:40] = 0.03
    assert spot(small).width_px <= 1 < 4 <= spot(wide).width_px


def test_a_change_of_all_light_has_no_corner():
    result = spot(np.full_like(LIGHT, -0.05))
    assert result.part > 0.95
    assert "of the picture, 5 % darker; most" in result.sentence


def test_a_faint_change_of_all_light_is_even():
    """By 0.7 %: 6 standard errors of all light, of no place."""
    result = spot(np.full_like(LIGHT, 0.007))
    assert not result.clear
    assert result.all_light[0] == pytest.approx(0.007, abs=0.003)
    assert result.sentence.startswith("Where: evenly over the picture, 0.")
    assert "brighter" in result.sentence


@pytest.mark.parametrize("filtered", [False, True], ids=["independent", "filtered"])
def test_noise_alone_has_a_place_as_seldom_as_stated(filtered):
    """At most 9 of 100 below a probability of 0.03, and not none below a half."""
    shares = np.array([spot(0 * LIGHT, seed, filtered).probability for seed in range(100)])
    assert (shares < 0.03).sum() <= 9
    assert (shares < 0.5).sum() >= 5
    assert "no place stands out" in spot(0 * LIGHT, 3, filtered).sentence


def test_a_surface_that_covers_the_place_lends_its_name():
    change = np.zeros_like(LIGHT)
    change[30:38, 6:16] = 0.08
    surfaces = {
        "floor": np.arange(SIZE)[:, None] * np.ones(SIZE) >= 28,
        "wall": np.arange(SIZE)[:, None] * np.ones(SIZE) < 28,
    }
    result = spot(change, surfaces=surfaces, band="530")
    assert "on floor" in result.sentence
    assert "brighter in band 530" in result.sentence
    assert result.record()["surface"] == "floor"


def test_a_known_place_is_where_the_peak_is_even_next_to_a_brighter_pixel():
    change = np.zeros_like(LIGHT)
    change[30:34, 6:10], change[5, 40] = 0.2, 3.0
    assert spot(change).peak == (40, 5)
    x, y = spot(change, within=(4, 28, 12, 36)).peak
    assert 6 <= x < 10
    assert 30 <= y < 34
