"""Pixels that the lens's own edge hides, in a flat of any level, and hot pixels in noise of any size."""

import numpy as np
import pytest
from cboxlab.calibration.correction.defects import hot_pixels, vignetted_pixels


@pytest.mark.parametrize("level", [0.2, 1.0, 7.0])
def test_a_tenth_of_the_flats_maximum_is_the_limit(level):
    response = np.full((100, 100), level)
    response[:5, :10], response[:5, 10:20] = 0.099 * level, 0.101 * level
    response[50, 50] = 40 * level  # one hot pixel is not the maximum
    expected = np.zeros((100, 100), bool)
    expected[:5, :10] = True
    np.testing.assert_array_equal(vignetted_pixels(response), expected)


@pytest.mark.parametrize("sigma", [0.2, 1.0, 30.0])
def test_a_hot_pixel_is_ten_of_the_others_deviations_above_them(sigma):
    dark = 60 + sigma * np.random.default_rng(1).standard_normal((60, 60))
    dark[7, 9], dark[20, 3], dark[30, 40] = 60 + np.array([10, -10, 3]) * sigma
    assert np.argwhere(hot_pixels(dark, 1e-6)).tolist() == [[7, 9]]
