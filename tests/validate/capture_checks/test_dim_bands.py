"""Bands whose light does not suit the lamp: of an unknown scene against their neighbours, and all of another lamp."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.capture_checks.lamp import _check_bands, _check_dim_bands


@pytest.mark.parametrize(
    ("level", "dim"),
    [
        ([1, 1, 0.1, 1, 1], [2]),
        ([0.05, 1, 1, 1, 1], [0]),
        ([1, 1, 1, 1, 0.05], [4]),
        ([1, 1, 0.12, 0.5, 1], []),  # 16 % of the mean of its neighbours, 0.75
        ([1, 1, 0.1, 0.5, 1], [2]),
        ([0.5, 1, 0.12, 1, 1], [2]),
        ([1, 1, 1, 0.1, 0.1], []),
    ],
)
def test_a_band_is_dim_among_both_neighbours(level, dim):
    capture = SimpleNamespace(band_ids=[f"f{number}" for number in range(5)])
    level = np.array(level, float)
    dim_bands = [suspicion.where for suspicion in _check_dim_bands(capture, level, level / np.median(level))]
    assert dim_bands == [f"band[{number}] (f{number})" for number in dim]


@pytest.mark.parametrize(
    ("ratios", "where"),
    [
        ([0.14, 0.4, 1.0, 1.9, 2.9, 4.0, 0.04], ["lamp.radiance"]),
        ([1.7, 1.0, 1.0, 1.0, 1.4, 1.0, 1.0], ["band[0] (f0)", "band[4] (f4)"]),  # a white balance
        ([1.0, 1.02, 0.5, 0.97, 1.0, 1.0, 1.1], ["band[2] (f2)"]),
        ([0.5, 1.0, 2.0, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0], ["band[0] (f0)", "band[2] (f2)", "band[4] (f4)"]),
    ],
)
def test_most_bands_unlike_the_lamp_are_another_lamp(ratios, where):
    bands = [SimpleNamespace(id=f"f{number}", transmittance=None) for number in range(len(ratios))]
    capture = SimpleNamespace(band_ids=[band.id for band in bands], manifest=SimpleNamespace(band=bands))
    assert [suspicion.where for suspicion in _check_bands(capture, np.array(ratios))] == where
