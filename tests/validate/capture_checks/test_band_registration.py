"""A shift that all halves of a picture share."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.capture_checks.band_registration import _check_step, _is_alike_in_halves, _shift
from scipy.ndimage import gaussian_filter


@pytest.mark.parametrize("moved", [(3, 0), (-4, 2)])
def test_halves_of_a_small_picture_share_its_shift(moved):
    """A picture of 40 px, and itself displaced by some pixels; other content has no shift in common with it."""
    random = np.random.default_rng(1)
    wide = gaussian_filter(random.normal(size=(80, 80)), 1.5)
    u, v = moved
    first, second = wide[20:60, 20:60], wide[20 - v : 60 - v, 20 - u : 60 - u]
    shift = _shift(first, second)
    np.testing.assert_allclose(shift, moved, atol=0.1)
    assert _is_alike_in_halves(first, second, shift)
    other = gaussian_filter(random.normal(size=(40, 40)), 1.5)
    assert not _is_alike_in_halves(first, other, shift)


def test_a_movement_between_two_bands_is_that_of_the_later_against_the_earlier():
    """The third band has no edges; a camera that stands still has no movement, wherever it stands."""
    capture = SimpleNamespace(band_ids=tuple("abcdef"))
    before, after, unclear = [1.0, 0.5], [3.0, 0.25], [np.nan, np.nan]
    (moved,) = _check_step(capture, np.array([before, before, unclear, before, after, after]))
    assert "between d and e" in moved.what and "(+2.00, -0.25) px" in moved.why
    assert not [*_check_step(capture, np.array([before] * 6))]
