"""Light that pixels exchange: a small blur by its second moments, a streak by a Gaussian along a line."""

from __future__ import annotations

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields.exchange import with_moments, with_streak
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d

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
    after_smear = np.tensordot(moments, with_moments(_spot()), 1)
    assert_allclose(after_smear, smeared - _spot(), atol=0.05 * np.abs(smeared - _spot()).max())


@pytest.mark.parametrize(("angle_deg", "axis"), [(0.0, 1), (90.0, 0)])
def test_a_streak_along_rows_or_columns_is_a_gaussian_in_one_dimension(angle_deg: float, axis: int) -> None:
    picture = np.random.default_rng(3).uniform(0, 1, (40, 50))
    expected = gaussian_filter1d(picture, 5.0, axis, mode="nearest", truncate=8) - picture
    assert_allclose(with_streak(picture, angle_deg, 5.0), expected, atol=2e-3)


@pytest.mark.parametrize("angle_deg", [30.0, 105.0])
def test_a_streak_spreads_a_spot_along_its_line(angle_deg: float) -> None:
    y, x = np.indices((121, 121)) - 60.0
    spot = np.exp(-(x**2 + y**2) / (2 * _SPOT**2))
    spread = with_streak(spot, angle_deg, 12.0) + spot
    right, down = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    along, across = x * right + y * down, y * right - x * down
    wide2 = _SPOT**2 + 12.0**2
    expected = _SPOT / np.sqrt(wide2) * np.exp(-(along**2) / (2 * wide2) - across**2 / (2 * _SPOT**2))
    assert_allclose(spread, expected, atol=1e-3)
