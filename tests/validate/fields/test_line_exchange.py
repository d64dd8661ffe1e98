"""Blurs along a line are the exchange with neighbours along it; a round blur is none."""

from __future__ import annotations

import numpy as np
import pytest
from cboxlab.validate.fields import along_lines
from numpy.testing import assert_allclose

#: Standard deviation of a Gaussian spot, and length of a smear, px.
_SPOT, _LENGTH = 4.0, 0.8


def _spot(right: float = 0.0, down: float = 0.0) -> np.ndarray:
    y, x = np.indices((41, 41)) - 20.0
    return np.exp(-((x - right) ** 2 + (y - down) ** 2) / (2 * _SPOT**2))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0, 90.0, 135.0])
def test_a_smear_less_its_round_part_is_two_numbers(angle_deg: float) -> None:
    right, down = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    steps = (np.arange(100) + 0.5) / 100 * _LENGTH - _LENGTH / 2
    smeared = np.mean([_spot(step * right, step * down) for step in steps], axis=0)
    y, x = np.indices((41, 41)) - 20.0
    # second derivatives of the spot along both axes and across, of which a smear is L^2 / 24 times those along it
    xx, yy = (_spot() * (one**2 / _SPOT**4 - 1 / _SPOT**2) for one in (x, y))
    expected = smeared - _spot() - _LENGTH**2 / 48 * (xx + yy)
    variance = _LENGTH**2 / 12
    numbers = variance * (right**2 - down**2) / 2, variance * right * down / 2
    found = np.tensordot(numbers, along_lines(_spot()), 1)
    assert_allclose(found, expected, atol=0.1 * np.abs(expected).max())
