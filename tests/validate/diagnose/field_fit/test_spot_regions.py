"""The border between noise and a spot, in standard deviations of the smoothed excess."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.field_fit import hot_spot, hot_spot_of_one_band
from cboxlab.validation.diagnose.field_fit.spot_appearance import _sharp_line
from cboxlab.validation.diagnose.field_fit.spot_regions import _MAX_BELLS, bells_on
from cboxlab.validation.diagnose.field_fit.surface_spot import surface_spot
from helpers.captures.small_excess import BANDS, COLUMNS, ROWS, SIGNAL, small_excess
from scipy.ndimage import gaussian_filter

#: A smooth excess over noise, of peak 1 after the smoothing by 1.5 px.
BELL = np.exp(-((COLUMNS - 24) ** 2 + (ROWS - 24) ** 2) / 18)
BELL /= gaussian_filter(BELL, 1.5).max()
#: Part of a pixel's standard deviation that is left by the smoothing of white noise: 1 / (2 sqrt(pi) 1.5 px).
SMOOTHED = 0.18806


@pytest.mark.parametrize(("sigmas", "is_spot"), [(5.5, False), (6.5, True)])
@pytest.mark.parametrize(
    ("region", "variance", "bands"),
    [(hot_spot, 2 * BANDS, slice(None)), (hot_spot_of_one_band, 2 * BANDS / (BANDS - 1), slice(2, 3))],
)
def test_a_spot_begins_at_six_sigmas(region, variance, bands, sigmas, is_spot):
    """chi2 of one number has variance 2; one band less the mean of the others has that of n / (n - 1) bands."""
    data = small_excess(np.zeros(SIGNAL.shape))
    excess = np.zeros(SIGNAL.shape)
    excess[bands] = sigmas * SMOOTHED * np.sqrt(variance) * BELL / len(excess[bands])
    data = replace(data, residual=np.sqrt(data.used + excess).astype(np.float32))
    assert (region(data) is not None) is is_spot


@pytest.mark.parametrize(("apart_px", "is_sharp"), [(0.9, False), (1.1, True), (-1.1, True)])
@pytest.mark.parametrize("across_rows", [False, True])
def test_a_line_from_side_to_side_is_a_thread_if_its_ends_are_a_pixel_apart(apart_px, is_sharp, across_rows):
    """Shared between two pixels of each column; one along a column may be a faulty column."""
    x = np.arange(60)
    row = 30.3 + apart_px * (x - 29.5) / 60
    weight = np.zeros((60, 60))
    weight[np.floor(row).astype(int), x], weight[np.floor(row).astype(int) + 1, x] = 1 - row % 1, row % 1
    assert _sharp_line(weight.T if across_rows else weight) is is_sharp


@pytest.mark.parametrize("side", [60, 120])
def test_bells_on_a_wide_region_are_about_as_many_as_allowed(side):
    maps = bells_on(np.pad(np.ones((side, side), bool), 5), None)
    assert 0.8 * _MAX_BELLS < len(maps.centres) < 1.3 * _MAX_BELLS
    assert maps.pitch == pytest.approx(side / np.sqrt(_MAX_BELLS))


@pytest.mark.parametrize("side", [59, 60, 61, 63])
def test_bells_reach_every_end_of_a_region(side):
    """No pixel is further from a centre than the pitch, along rows and columns."""
    maps = bells_on(np.pad(np.ones((side, side + 2), bool), 5), None)
    u, v = np.array(maps.centres).T
    for end, positions in ((side + 4, v), (side + 6, u)):
        assert positions.min() == 5 and end - positions.max() <= maps.pitch


def test_a_region_between_the_places_of_the_grid_has_a_bell():
    """Behind a mosaic bells are a repeat apart, and a diagonal of two pixels may have none of these places."""
    region = np.zeros((20, 20), bool)
    region[[10, 11], [11, 10]] = True
    ((u, v),) = bells_on(region, (2, 2)).centres
    assert region[int(v), int(u)]


def test_a_surface_on_which_no_bell_lies_has_no_spot():
    region, surface = np.zeros(SIGNAL.shape[1:], bool), np.full(SIGNAL.shape[1:], -1)
    region[10, [10, 30]], surface[10, 30] = True, 0
    data = replace(small_excess(np.zeros(SIGNAL.shape)), cell=(8, 8), surface=surface)
    assert surface_spot(data, region) is None
