"""Bands of an unknown scene against their neighbours."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.capture_checks.lamp import _check_dim_bands


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
