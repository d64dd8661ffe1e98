"""Noise of single pictures that a filter makes alike, flat or stronger in dark parts."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress import Side, regress_sides
from cboxlab.validation.compare_renders.regress.patterns import (
    Difference,
    alike_along_edges,
    moved_part,
    odd_tiles,
    reused_numbers,
    scatter_of_blocks,
    slow_change,
)
from scipy.ndimage import gaussian_filter, uniform_filter
from scipy.stats import binom, t

SIZE = 48
Y, X = np.meshgrid(*2 * [np.linspace(-1, 1, SIZE)], indexing="ij")
LIGHT = 0.7 * (1 + 0.4 * X + 0.3 * Y**2)
INSIDE = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)


@pytest.mark.parametrize("seed", [4, 15, 18])
def test_noise_of_a_filter_along_rows_does_not_repeat_in_tiles(seed):
    """Neighbours that are alike make the sums of most tiles larger."""
    rng, light = np.random.default_rng(seed), LIGHT
    noise = [gaussian_filter(rng.standard_normal(light.shape), (0.3, 1.2)) for _ in range(2)]
    first, second = (light * (1 + 0.4 * part) for part in noise)
    assert reused_numbers(Difference(first, second - first, None, INSIDE, {})).probability > 2e-2


@pytest.mark.parametrize(("others", "is_clear"), [(0.1, False), (0.6, True)], ids=["the steepest edge", "steeper ones"])
def test_behind_a_filter_only_edges_that_are_steeper_and_stay_show_a_motion(others, is_clear):
    rng, (y, x) = np.random.default_rng(9), np.indices((SIZE, SIZE))

    def picture(middle):
        values = LIGHT * (1 + 0.02 * rng.standard_normal((SIZE, SIZE)))
        for row, column, contrast in ((14, middle, 0.3), *((34, at, others) for at in (9, 30, 41))):
            values *= 1 - contrast * gaussian_filter(np.clip(4.5 - np.hypot(y - row, x - column), 0, 1), 0.5)
        return values

    first, second = picture(30.0), picture(30.7)
    difference = Difference(first, second - first, None, INSIDE, {}, clustering=1.2)
    assert (moved_part(difference, first, second).probability < 1e-2) == is_clear


def test_noise_of_bright_parts_in_dark_ones_is_no_slow_change():
    """A denoiser of another strength brightens a dark part by 30 %, by far less than the noise of bright parts."""
    rng, is_dark = np.random.default_rng(4), Y < -0.4
    light = np.where(is_dark, 0.01, 1.0) * LIGHT
    first, second = (light * (1 + 0.1 * rng.standard_normal(light.shape)) for _ in range(2))
    total = np.where(is_dark, 1.3, 1.0) * second - first
    assert slow_change(Difference(first, total, None, INSIDE, {})).probability > 1e-3


def test_tiles_that_a_filter_left_flat_are_not_odd():
    """Nine flat tiles off by what the noise of their pixels allows."""
    rng, light = np.random.default_rng(5), LIGHT
    total = 0.1 * light * rng.standard_normal(light.shape)
    flat = np.kron(0.025 * rng.standard_normal((3, 3)), np.ones((4, 4)))
    total[12:24, 20:32] = light[12:24, 20:32] * (flat + 1e-4 * rng.standard_normal((12, 12)))
    assert odd_tiles(Difference(light, total, None, INSIDE, {})).probability > 1e-3
    total[12:16, 20:24] += 0.3
    assert odd_tiles(Difference(light, total, None, INSIDE, {})).probability < 1e-4


@pytest.mark.parametrize("width_px", [1, 3, 5])
def test_scatter_of_blocks_gives_the_standard_error_of_filtered_noise(width_px):
    """A box filter that wraps around leaves the mean of white noise alone: its variance is one over the pixels.

    Of 500 pictures 5 % are off by more than Student's t allows. The limits of their number are passed in one of 1,000
    runs, where the variance is right within a tenth.
    """
    rng, size = np.random.default_rng(width_px), 64
    block = (np.arange(size)[:, None] // 8 * 8 + np.arange(size) // 8).ravel()
    variances, alarms = [], 0
    for _ in range(500):
        noise = uniform_filter(rng.standard_normal((size, size)), width_px, mode="wrap").ravel()
        variance, degrees = scatter_of_blocks(noise, np.ones(size**2), block, 1 + width_px**2 / 64)
        variances.append(variance / size**2)
        alarms += abs(noise.sum()) > t.isf(0.025, degrees) * np.sqrt(variance)
    assert np.mean(variances) == pytest.approx(1, abs=0.1)
    rates = [2 * t.sf(t.isf(0.025, degrees) * scale, degrees) for scale in (np.sqrt(1.1), np.sqrt(0.9))]
    assert binom.ppf(5e-4, 500, rates[0]) <= alarms <= binom.isf(5e-4, 500, rates[1])


@pytest.mark.parametrize(("width_px", "is_visible"), [(0.5, True), (2.5, False)])
def test_single_pictures_whose_noise_a_denoiser_hides_say_so(width_px, is_visible):
    """Noise of a pixel filter is visible."""
    rng = np.random.default_rng(3)

    def side(name):
        noise = 0.1 * gaussian_filter(rng.standard_normal((SIZE, SIZE)), width_px)
        picture = np.repeat((LIGHT * (1 + noise))[..., None], 3, axis=-1)
        return Side(name, np.full(3, np.nan), picture, None, 0.0, None, in_colour=True, colours=("R", "G", "B"))

    outcome, _ = regress_sides(side("first"), side("second"))
    sentence = outcome.to_dict()["noise_not_visible"]
    assert outcome.same and (sentence is None) == is_visible
    assert is_visible or (sentence.startswith("These pictures look denoised") and sentence in outcome.lines())


def test_motion_where_few_slopes_count_has_a_size_that_can_be_seen():
    """Moving sums leave rounding of either sign in the even part, whose count of slopes had no bounds."""
    rng = np.random.default_rng(0)
    first = np.ones((48, 48))
    first[:, :20] += rng.random((48, 20))
    second = first.copy()
    second[:, :20] *= 1 + 0.05 * rng.standard_normal((48, 20))
    finding = moved_part(Difference(first, second - first, None, first > 0, {}, 80.0), first, second)
    assert finding.probability == 1 and not np.isnan(finding.typical_sigma)


def test_what_a_name_leaves_along_edges_is_noise_or_of_one_sign():
    """Noise through a filter is as alike along a ring as elsewhere: 5 % are below 5 %; 8 of 40 are so by 1e-3."""
    rng, (y, x) = np.random.default_rng(7), np.indices((64, 64))
    edges = np.abs(np.hypot(y - 32, x - 32) - 20) < 2
    below = 0
    for _ in range(40):
        rest = 3 * gaussian_filter(rng.standard_normal((64, 64)), 0.6)
        below += alike_along_edges(rest, edges, ~edges) < 0.05
    assert below < 8
    assert alike_along_edges(rest + edges * np.sign(x - 32), edges, ~edges) < 1e-3
