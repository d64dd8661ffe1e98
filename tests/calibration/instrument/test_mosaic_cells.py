"""Means over the repeats of a mosaic, one pixel of each, and channels with their gaps filled."""

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_mask
from cboxlab.calibration.instrument import cell_means, interpolated_channel, one_pixel_of_each_cell

SHAPE, PATTERN = (7, 9), "RGGB"


def test_means_of_each_bands_used_pixels_and_their_variance():
    random = np.random.default_rng(1)
    signal, variance = random.uniform(1, 2, (3, *SHAPE)), random.uniform(1, 2, (3, *SHAPE))
    used = np.stack([channel_mask(PATTERN, SHAPE, channel) for channel in "RGB"])
    used[1, 2, 1] = False  # one of the two green pixels of a cell
    used[0, 4, 4] = False  # the only red one
    means = cell_means(signal, variance, used, (2, 2))
    assert np.all(means.signal[1, :2, :2] == pytest.approx((signal[1, 0, 1] + signal[1, 1, 0]) / 2))
    assert np.all(means.variance[1, :2, :2] == pytest.approx((variance[1, 0, 1] + variance[1, 1, 0]) / 4))
    assert np.all(means.signal[1, 2:4, :2] == signal[1, 3, 0]) and np.all(
        means.variance[1, 2:4, :2] == variance[1, 3, 0]
    )
    lacking = np.zeros(SHAPE, bool)
    lacking[4:6, 4:6] = True
    lacking[6:] = lacking[:, 8:] = True  # cut cells have no blue pixel
    assert np.array_equal(means.complete, ~lacking)


def test_a_cell_counts_once():
    where = np.ones(SHAPE, bool)
    where[:2, :2] = [[False, False], [False, True]]
    where[2:4, :2] = False
    single = one_pixel_of_each_cell(where, (2, 2))
    assert single.sum() == 4 * 5 - 1 and single[1, 1] and not (single & ~where).any()


@pytest.mark.parametrize("channel", ["R", "G", "B", "G2"])
def test_a_gradient_is_interpolated_exactly_inside(channel):
    v, u = np.indices((12, 12))
    image = 3.0 + 2 * v - u
    mask = channel_mask(PATTERN, image.shape, channel)
    filled = interpolated_channel(np.where(mask, image, -9.0), mask, (2, 2))
    np.testing.assert_allclose(filled[2:-2, 2:-2], image[2:-2, 2:-2])
    assert np.isfinite(filled).all()
