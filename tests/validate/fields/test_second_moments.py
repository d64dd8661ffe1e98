"""A blur is three exchanges with neighbours, by its second moments."""

from __future__ import annotations

import numpy as np
import pytest
from cboxlab.validate.fields import with_moments
from numpy.testing import assert_allclose

#: Standard deviation of a Gaussian spot, and length of a smear, px.
_SPOT, _LENGTH = 4.0, 0.8


def _spot(right: float = 0.0, down: float = 0.0) -> np.ndarray:
    y, x = np.indices((41, 41)) - 20.0
    return np.exp(-((x - right) ** 2 + (y - down) ** 2) / (2 * _SPOT**2))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0, 90.0, 135.0])
def test_a_smear_is_its_three_second_moments(angle_deg: float) -> None:
    right, down = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    steps = (np.arange(100) + 0.5) / 100 * _LENGTH - _LENGTH / 2
    smeared = np.mean([_spot(step * right, step * down) for step in steps], axis=0)
    variance = _LENGTH**2 / 12
    moments = np.array([1.0, right**2 - down**2, right * down]) * variance / 2
    found = np.tensordot(moments, with_moments(_spot()), 1)
    assert_allclose(found, smeared - _spot(), atol=0.05 * np.abs(smeared - _spot()).max())
