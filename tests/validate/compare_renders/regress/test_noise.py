"""Noise of many bands in a time that is linear in their number: shortcuts equal what they stand for."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.noise import Noise, _by_light, _correlation


def some_noise(correlated):
    rng = np.random.default_rng(2)
    variance = rng.random((12, 10, 5))
    correlation = np.corrcoef(rng.standard_normal((5, 9))) if correlated else None
    bare = Noise(variance, 3.0, correlation, np.zeros(()), 1.0, 1.0, False)
    return replace(bare, total=bare.over(np.ones(5)))


@pytest.mark.parametrize("correlated", [True, False])
def test_the_variance_of_a_band_is_that_of_its_unit_vector(correlated):
    noise = some_noise(correlated)
    for band, row in enumerate(np.eye(5)):
        assert np.array_equal(noise.of_band(band), noise.over(row))


def test_outliers_take_the_variance_of_their_neighbours_and_others_keep_theirs():
    noise, outlier = some_noise(True), np.zeros((12, 10), bool)
    outlier[4, 5] = True
    quiet = noise.with_quiet_outliers(np.ones((12, 10, 5)), outlier)
    assert np.array_equal(quiet.variance[~outlier], noise.variance[~outlier])
    assert np.array_equal(quiet.total, quiet.over(np.ones(5)))


def test_the_correlation_of_strips_is_that_of_the_entire_picture():
    """150 rows are three strips; two bands share half of their variance."""
    rng = np.random.default_rng(3)
    common = rng.standard_normal((150, 40, 1))
    difference = common + rng.standard_normal((150, 40, 2))
    uniform = np.ones_like(difference)
    matrix = _correlation(difference, 2 * uniform, uniform, np.ones((150, 40), bool))
    assert matrix[0, 1] == pytest.approx(0.5, abs=0.05)
    assert np.diag(matrix) == pytest.approx([1.0, 1.0], abs=1e-12)


def test_noise_is_no_function_of_the_light_and_a_power_is_one():
    """Uniform light with noise has no part by its light; a gamma of 1.1 is found to a tenth."""
    rng = np.random.default_rng(4)
    smooth = np.ones((60, 60), bool)
    noisy, again = 1 + 0.1 * rng.standard_normal((2, 60, 60))
    assert _by_light(again - noisy, noisy, smooth).std() < 0.3 * 0.1
    level = rng.uniform(0.5, 2, (60, 60))
    bent = level**1.1 - level
    assert np.abs(_by_light(bent, level, smooth) - bent).mean() < 0.1 * np.abs(bent).mean()
