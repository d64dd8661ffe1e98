"""A calibration curve of three knots, by hand: inside, beyond both ends, and back."""

import numpy as np
import pytest
from cboxlab.calibration.detector.nonlinearity import CalibrationCurve, LightSeries, _scale, fit_curve

CURVE = CalibrationCurve(
    np.array([10.0, 110.0, 310.0]), np.array([0.0, 0.6, 1.0]), {}, np.array([0.1, -0.2]), np.zeros(2), 0.0
)


def test_lines_between_knots_go_on_beyond_the_ends():
    """Slopes of 0.006 and 0.002 a count."""
    counts = [-10.0, 10.0, 60.0, 110.0, 210.0, 310.0, 360.0]
    assert CURVE.linear(counts) == pytest.approx([-0.12, 0.0, 0.3, 0.6, 0.8, 1.0, 1.1])
    assert CURVE.count([0.0, 0.3, 0.6, 0.8, 1.0]) == pytest.approx([10.0, 60.0, 110.0, 210.0, 310.0])


def test_statistics_of_residuals_by_hand():
    statistics = CURVE.statistics
    assert statistics["mean_absolute"] == pytest.approx(0.15)
    assert statistics["rms"] == pytest.approx(np.sqrt(0.025))
    assert statistics["largest"] == pytest.approx(0.2)


def test_the_scale_of_a_light_is_that_of_least_squares():
    light, value = np.array([1.0, 2.0, 4.0]), np.array([2.0, 7.0, 11.0])
    assert _scale(light, value) == pytest.approx(np.linalg.lstsq(light[:, None], value, rcond=None)[0][0])


def test_straight_counts_of_two_lights_leave_no_residual():
    """Lights of other strengths; one point ten standard deviations too high is missed by half of that at least."""
    light, sigma = np.linspace(1.0, 10.0, 10), np.full(10, 1.0)
    first, second = 50 + 100 * light, 50 + 20 * light

    def residual():
        return fit_curve([LightSeries("a", light, first, sigma), LightSeries("b", light, second, sigma)], 50.0).residual

    assert np.abs(residual()).max() < 1e-6
    second[7] += 10
    assert 5 / 1000 > np.abs(residual()).max() > 1 / 1000
