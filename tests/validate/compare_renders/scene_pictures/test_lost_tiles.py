"""Tiles that one picture of a side has lost."""

import numpy as np
import pytest
import xarray as xr
from cboxlab.validation.compare_renders.regress import regress_pictures
from cboxlab.validation.compare_renders.regress.sides import side_of
from cboxlab.validation.compare_renders.scene_pictures import lost_tiles
from scipy.ndimage import median_filter

SIDE = 48
TILE = np.s_[16:24, 32:40]


def pictures(seed, count=4):
    """(n, y, x, 3) pictures with independent noise of a tenth."""
    noise = np.random.default_rng(seed).normal(1, 0.1, (count, SIDE, SIDE, 3))
    return np.linspace(0.5, 2, SIDE)[:, None, None] * noise


def verdict(baseline, candidate):
    sides = [
        side_of([xr.Dataset({"rgb": (("y", "x", "component"), each)}) for each in stack], [f"{n}{i}" for i in range(4)])
        for n, stack in (("b", baseline), ("c", candidate))
    ]
    return regress_pictures(*sides)


@pytest.mark.parametrize("value", [0.0, (1.0, 0.0, 1.0)])
def test_a_tile_that_one_picture_has_lost_is_a_difference_and_is_not_in_the_means(value):
    spoilt = pictures(1)
    spoilt[2][TILE] = value
    lost = lost_tiles(spoilt, "0123")
    assert [each and int(each.pixels.sum()) for each in lost] == [None, None, 64, None]
    outcome = verdict(pictures(0), spoilt)
    assert [row.kind for row in outcome.deciding] == ["numbers"]
    assert any("64 pixels are a lost tile in the candidate (one value in c2 alone" in line for line in outcome.lines())


def test_what_all_pictures_have_and_noise_with_equal_pixels_are_no_lost_tiles():
    background = pictures(2)
    background[(slice(None), *TILE)] = 0.0
    draw = np.random.default_rng(3)
    sparse = [draw.gamma(1, 1, (4, SIDE, SIDE, 1)) * (draw.random((4, SIDE, SIDE, 1)) < part) for part in (0.03, 0.3)]
    filtered = median_filter(np.round(pictures(4), 1), (1, 5, 5, 1))
    for stack in (background, *sparse, filtered):
        assert lost_tiles(stack, "0123") == [None] * 4
